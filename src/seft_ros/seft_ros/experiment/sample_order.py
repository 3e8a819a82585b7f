"""Which step of a test a node may take in next."""

from seft_msgs_py.errors import WireError
from seft_msgs_py.messages import Status
from seft_msgs_py.timebase import Timebase

from seft_ros.experiment.state_machine import MOVING

FARTHEST = 10.0  # s: who was held up for longer has lost the test anyway
ABSURD = 1e9
"""No rig has m, m/s, m/s^2 or N beyond this."""


class SampleOrder:
    """Tells the samples of a test from those that are stale, repeated, or not of it.

    Parameters
    ----------
    pace : str
        Of the rig; in ``lockstep`` no step comes before the last one is answered.
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
    may_begin : bool
        Whether the next sample of step 0 begins a test: once for each time that one has ended.
    """

    def __init__(self, pace: str, timebase: Timebase, loop_delay: int = 0) -> None:
        self._ahead = 1 + loop_delay if pace == "lockstep" else round(FARTHEST * timebase.rate)
        self._is_supervised = False
        self.last = -1
        self.steps = 0
        self.may_begin = True

    def follow(self, experiment: Status) -> None:
        """Take in a state of the experiment."""
        self._is_supervised = True
        if experiment.message in MOVING:
            steps = experiment.values.get("steps", "")
            if steps.isdecimal() and len(steps) < 19:
                self.steps = int(steps)
        else:
            self.steps = 0
            self.may_begin = True

    def begins(self, step: int) -> bool:
        """Say whether a sample of this step begins a test; if so, it has begun."""
        if step != 0 or not (self.may_begin if self._is_supervised else self.last != 0):
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
        if step > self.last + self._ahead:
            raise WireError(f"{name} of step {step} after step {self.last}: far in the future")
