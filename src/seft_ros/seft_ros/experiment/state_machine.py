"""The states of a test and the ways between them, without ROS."""

from dataclasses import dataclass
from enum import StrEnum


class State(StrEnum):
    """States of a test."""

    IDLE = "idle"
    READY = "ready"
    RUNNING = "running"
    DONE = "done"
    TRIPPED = "tripped"


@dataclass(frozen=True)
class Answer:
    """Answer to a request: whether it was done, and what happened or why not."""

    accepted: bool
    text: str


class StateMachine:
    """State of a test.

    ::

        idle <-> ready -> running -> done | tripped -> (reset) -> idle
        estop: from every state to tripped

    Attributes
    ----------
    state : State
        Where the test is.
    detail : str
        Why: what is waited for, or how the test ended.
    step : int or None
        Step of a trip.
    """

    def __init__(self) -> None:
        self.state = State.IDLE
        self.detail = "starting"
        self.step: int | None = None

    def peers(self, waiting_for: str) -> None:
        """Take in what the graph still lacks; empty if it is complete."""
        if self.state in (State.IDLE, State.READY):
            self.state = State.IDLE if waiting_for else State.READY
            self.detail = f"waiting for {waiting_for}" if waiting_for else "all nodes are ready"

    def start(self) -> Answer:
        """Start the test; only a ready one starts."""
        if self.state is not State.READY:
            return self._refusal("start")
        self.state, self.detail, self.step = State.RUNNING, "running", None
        return Answer(True, "the test is running")

    def finish(self, detail: str) -> None:
        """End a running test at the end of its record."""
        if self.state is State.RUNNING:
            self.state, self.detail = State.DONE, detail

    def trip(self, reason: str, step: int | None = None) -> None:
        """End a running test because of a limit or a fault."""
        if self.state is State.RUNNING:
            self.state, self.detail, self.step = State.TRIPPED, reason, step

    def stop(self) -> Answer:
        """End a running test at the operator's wish."""
        if self.state is not State.RUNNING:
            return self._refusal("stop")
        self.state, self.detail = State.DONE, "stopped by the operator"
        return Answer(True, "the test is stopped")

    def estop(self) -> Answer:
        """Trip from any state."""
        self.state, self.detail, self.step = State.TRIPPED, "emergency stop", None
        return Answer(True, "emergency stop; reset before the next test")

    def reset(self) -> Answer:
        """Make the next test possible after one has ended."""
        if self.state not in (State.DONE, State.TRIPPED):
            return self._refusal("reset")
        self.state, self.detail, self.step = State.IDLE, "reset", None
        return Answer(True, "idle")

    def _refusal(self, request: str) -> Answer:
        return Answer(False, f"can't {request}: the test is {self.state} ({self.detail})")
