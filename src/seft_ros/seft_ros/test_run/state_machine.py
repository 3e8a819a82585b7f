"""States of a test and the transitions between them, and which samples a state admits.

docs/safety.md shows them as a diagram.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.experiment_state import ExperimentState
from seft_msgs_py.wire.outcome import BY_OPERATOR, ENDED, MOVING, State
from seft_msgs_py.wire.topics import Timebase

_ABORTED = "aborted by the operator"
"""Reason of a trip by ``estop``: the emergency stop proper is a button in hardware."""


@dataclass(frozen=True)
class ServiceAnswer:
    """Answer to a request: whether it was accepted, and what happened or why not."""

    accepted: bool
    text: str


class StateMachine:
    """State of a test.

    ::

        idle <-> ready -> running -> done                   the record's end
                          running -> ramping_down -> done | tripped     stop | soft trip
                          running | ramping_down -> tripped             hard trip
        done | tripped -> (reset) -> idle
        estop: from every state to tripped

    Attributes
    ----------
    state : State
        Where the test is.
    detail : str
        Why: what the test waits for, or how it ended.
    step : int or None
        Step of a trip.
    waited : float
        If a trip only says what did not come, the time waited for it, s; 0: its cause is known.
    """

    def __init__(self) -> None:
        self.state = State.IDLE
        self.detail = "starting"
        self.step: int | None = None
        self.waited = self._stood = 0.0
        self._then = State.DONE  # what the ramp leads to
        self._told: tuple[str, int | None] = "", None  # by another than a rig, in which step

    @property
    def log_line(self) -> str:
        """The state and its reason, for people who read a log."""
        name, at = self.state.replace("_", " "), "" if self.step is None else f" (step {self.step})"
        if self.state is State.READY:
            return "ready: start with seft start, or ros2 service call /start std_srvs/srv/Trigger"
        return name if self.detail == name else f"{name}: {self.detail}{at}"

    def peers(self, waiting_for: str) -> None:
        """Set what the graph still lacks; empty if it is complete."""
        if self.state in (State.IDLE, State.READY):
            self.state = State.IDLE if waiting_for else State.READY
            self.detail = f"waiting for {waiting_for}" if waiting_for else "all nodes are ready"

    def start(self) -> ServiceAnswer:
        """Start the test; only a ready one starts."""
        if self.state is not State.READY:
            return self._refusal("start")
        self._go(State.RUNNING, "running")
        return ServiceAnswer(True, "the test is running")

    def finish(self, detail: str) -> None:
        """End a test at the end of its record; a test that is ramping down keeps its cause."""
        if self.state is State.RUNNING:
            self._go(State.DONE, detail)
        else:
            self.at_rest()

    def soft_trip(self, reason: str, step: int | None = None, waited: float = 0.0) -> None:
        """Ramp a running test down because of a fault with which the loop still works.

        If it is ramping down already, the cause is added to the first one, and a stop becomes a
        trip.
        """
        if self.state is State.RUNNING:
            self._go(State.RAMPING_DOWN, reason, step, waited)
            self._then = State.TRIPPED
        elif self.state is State.RAMPING_DOWN and reason not in self.detail:
            self._add(reason, step)
            self._then = State.TRIPPED

    def at_rest(self) -> None:
        """End the ramp: the reference force is zero."""
        if self.state is State.RAMPING_DOWN:
            self.state = self._then

    def hard_trip(
        self, reason: str, step: int | None = None, waited: float = 0.0, *, by_rig: bool = False
    ) -> None:
        """End a test at once because of a limit or a fault; a ramp's cause is kept with it.

        Of two reasons in one step a rig's own stands, whichever is told first.
        """
        if self.state is State.RUNNING:
            self._go(State.TRIPPED, reason, step, waited)
        elif self.state is State.RAMPING_DOWN:
            self._go(State.TRIPPED, while_ramping_down(reason, self.detail), step, waited)
        elif by_rig and step is not None and self._told[1] == step:
            self.detail = self.detail.replace(self._told[0], reason, 1)
        else:
            return
        self._told = reason, None if by_rig else step

    def note(self, finding: str) -> None:
        """Add to a trip's cause what was found later."""
        if self.state is State.TRIPPED and finding not in self.detail:
            self._add(finding)

    def explain(self, cause: str, stood: float = 0.0) -> bool:
        """Put a cause before the silence for which a test tripped; return whether it is new.

        The cause is a node that ``stood`` still for so many seconds; of several, which reports may
        tell in any order, the one for the longest time. Else it is the first that is told. The
        silence is longer than what made it by up to some periods, and the wait in which it began.
        """
        known = not self.waited or self.state not in (State.RAMPING_DOWN, State.TRIPPED)
        least = max(self._stood, 0.5 * self.waited)
        if known or cause in self.detail or (stood < least if stood else self._stood > 0.0):
            return False
        self._stood = stood or least
        self.detail = f"{cause}; {self.detail}"
        return True

    def stop(self) -> ServiceAnswer:
        """Ramp a running test down for the operator."""
        if self.state is State.RAMPING_DOWN:
            return ServiceAnswer(True, f"the test is ramping down already ({self.detail})")
        if self.state is not State.RUNNING:
            return self._refusal("stop")
        self._go(State.RAMPING_DOWN, BY_OPERATOR)
        self._then = State.DONE
        return ServiceAnswer(True, "the test is ramping down")

    def estop(self) -> ServiceAnswer:
        """Trip from any state, at once; the reason of an earlier trip stays."""
        if self.state is State.TRIPPED:
            return ServiceAnswer(True, f"the test has tripped already ({self.detail}); reset it")
        if self.state is State.RAMPING_DOWN:
            self.hard_trip(_ABORTED)
        else:
            self._go(State.TRIPPED, _ABORTED)
        return ServiceAnswer(True, f"{_ABORTED}; reset before the next test")

    def reset(self, moving: bool = False) -> ServiceAnswer:
        """Allow a new test to start when one has ended and the rig is at rest."""
        if self.state not in ENDED:
            return self._refusal("reset")
        if moving:
            return ServiceAnswer(False, f"can't reset: the rig is not at rest ({self.state})")
        self._go(State.IDLE, "reset")
        return ServiceAnswer(True, "idle")

    def _go(self, state: State, detail: str, step: int | None = None, waited: float = 0.0) -> None:
        self._told = "", None
        self.state, self.detail, self.step = state, detail, step
        self.waited, self._stood = waited, 0.0

    def _add(self, finding: str, step: int | None = None) -> None:
        self.detail = f"{self.detail}; {finding}"
        self.step = step if self.step is None else self.step

    def _refusal(self, request: str) -> ServiceAnswer:
        return ServiceAnswer(False, f"can't {request}: the test is {self.state} ({self.detail})")


def while_ramping_down(reason: str, first: str) -> str:
    """Reason of a trip while a test was ramping down for a first cause."""
    return f"{reason} (while ramping down: {first})"


LOCKSTEP = "lockstep"
MAX_SKEW_S = 10.0  # s; a node that stalls for longer has lost the test anyway
ABSURD = 1e9
"""No rig has values beyond this in m, m/s, m/s^2 or N."""


def check_magnitude(what: str, step: int, values: npt.NDArray[np.float64]) -> None:
    """Check that a rig can have these finite values.

    Raises
    ------
    WireError
        If one is beyond `ABSURD`.
    """
    if math.hypot(*values.ravel().tolist()) > ABSURD and np.abs(values).max() > ABSURD:
        raise WireError(f"{what} {step} has a value beyond {ABSURD:g}")


class SampleOrder:
    """Tells valid samples of a test from stale, repeated and unexpected ones.

    Parameters
    ----------
    timebase : Timebase
        Sampling clock.
    loop_delay : int
        Steps by which a rig in lockstep may be ahead of the answer.

    Attributes
    ----------
    last : int
        Last answered step; -1 if none.
    steps : int
        Steps of the running test, 0 while no test is known to run.
    in_lockstep : bool
        Whether the rig of the running test waits for each answer before its next step.
    may_begin : bool
        Whether the next sample of step 0 begins a test: once after each end of a test.
    """

    def __init__(self, timebase: Timebase, loop_delay: int = 0) -> None:
        self._max_skew = round(MAX_SKEW_S * timebase.rate)
        self._ahead_in_lockstep = 1 + loop_delay
        self._state = ""  # of the experiment, as the supervisor reports it
        self.last, self.steps = -1, 0
        self.in_lockstep, self.may_begin = False, True

    def follow(self, experiment: ExperimentState) -> None:
        """Follow the state of the experiment; a repeated one is only a heartbeat."""
        if experiment.state == self._state:
            return
        self._state = experiment.state
        if experiment.state in MOVING:
            self.in_lockstep = experiment.pace == LOCKSTEP
            self.steps = self.steps if experiment.steps is None else experiment.steps
        else:
            self.steps = 0
            self.may_begin = True

    def begins(self, step: int) -> bool:
        """Begin a test if a sample of this step does so; return whether it does."""
        if step != 0 or not (self.may_begin if self._state else self.last != 0):
            return False
        self.may_begin = False
        self.last = -1
        return True

    def false_start(self, name: str, step: int) -> str:
        """Say that the first sample of a test is not that of step 0; empty if it is."""
        if not step or not self.may_begin or self.last >= 0:
            return ""
        return f"{name} begins with step {step}, not 0: is that lost, or are the stamps wrong?"

    def check(self, name: str, step: int) -> None:
        """Check that a sample of this step may be answered.

        Raises
        ------
        WireError
            If the step is answered already, or too far ahead.
        """
        if step <= self.last:
            raise WireError(f"{name} of step {step} after step {self.last} was answered")
        if step > self.last + (self._ahead_in_lockstep if self.in_lockstep else self._max_skew):
            raise WireError(f"{name} of step {step} after step {self.last}: far in the future")
