"""Which step of a test a node may take in next."""

import math

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.messages import Status
from seft_msgs_py.wire.timebase import Timebase

from seft_ros.experiment.state_machine import MOVING, PACE

LOCKSTEP = "lockstep"
FARTHEST = 10.0  # s: who was held up for longer has lost the test anyway
ABSURD = 1e9
"""No rig has m, m/s, m/s^2 or N beyond this."""


def check_magnitude(what: str, step: int, values: npt.NDArray[np.float64]) -> None:
    """See that finite values are such as a rig can have.

    Raises
    ------
    WireError
        If one is beyond `ABSURD`.
    """
    if math.hypot(*values.ravel().tolist()) > ABSURD and np.abs(values).max() > ABSURD:
        raise WireError(f"{what} {step} has a value beyond {ABSURD:g}")


class SampleOrder:
    """Tells the samples of a test from those that are stale, repeated, or not of it.

    Parameters
    ----------
    timebase : Timebase
        Sampling clock.
    loop_delay : int
        Steps that a rig in lockstep may go ahead of the answer.

    Attributes
    ----------
    last : int
        Last step that was answered; -1 where none was.
    steps : int
        Steps of the running test, 0 while none is known to run.
    in_lockstep : bool
        Whether the rig of the running test waits for each answer, so that no step comes before
        the last one is answered.
    may_begin : bool
        Whether the next sample of step 0 begins a test: once for each time that one has ended.
    """

    def __init__(self, timebase: Timebase, loop_delay: int = 0) -> None:
        self._farthest = round(FARTHEST * timebase.rate)
        self._ahead_in_lockstep = 1 + loop_delay
        self._state = ""  # of the experiment, as a supervisor tells
        self.last = -1
        self.steps = 0
        self.in_lockstep = False
        self.may_begin = True

    def follow(self, experiment: Status) -> None:
        """Take in a state of the experiment; a repeat is a sign of life and no news."""
        if experiment.message == self._state:
            return
        self._state = experiment.message
        if experiment.message in MOVING:
            self.in_lockstep = experiment.values.get(PACE) == LOCKSTEP
            steps = experiment.values.get("steps", "")
            if steps.isdecimal() and len(steps) < 19:
                self.steps = int(steps)
        else:
            self.steps = 0
            self.may_begin = True

    def begins(self, step: int) -> bool:
        """Say whether a sample of this step begins a test; if so, it has begun."""
        if step != 0 or not (self.may_begin if self._state else self.last != 0):
            return False
        self.may_begin = False
        self.last = -1
        return True

    def check(self, name: str, step: int) -> None:
        """See that a sample of this step may be answered.

        Raises
        ------
        WireError
            If it comes after its time, or from a future that can't have been reached.
        """
        if step <= self.last:
            raise WireError(f"{name} of step {step} after step {self.last} was answered")
        if step > self.last + (self._ahead_in_lockstep if self.in_lockstep else self._farthest):
            raise WireError(f"{name} of step {step} after step {self.last}: far in the future")
