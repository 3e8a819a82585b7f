"""Received reference forces: each step waits for its own, or uses the newest with previews."""

from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.errors import InputError, WireError
from seft_msgs_py.wire.outcome import LinkReport
from seft_msgs_py.wire.topics import REFERENCE_FORCE, Timebase
from seft_plant_sim.command import MessagesAhead

from seft_ros.protection.protected_force import RampDown, extrapolated

PENDING = 256  # steps kept while state or force is missing


class MatchedForces:
    """Reference forces by step, for a loop without a delay of its own."""

    def __init__(self) -> None:
        self._points: dict[int, Floats] = {}

    def reset(self, in_lockstep: bool = False) -> None:
        """Begin a new test; each force is waited for, also in lockstep."""
        self._points.clear()

    def take(self, step: int, points: Floats) -> None:
        """Take a message: the points of its step and future ones, shape (p, q, n).

        Raises
        ------
        WireError
            If a message of this step has arrived before.
        """
        if step in self._points:
            raise WireError(f"{REFERENCE_FORCE.name} of step {step} a second time")
        self._points[step] = points
        if len(self._points) > PENDING:
            self._points.pop(min(self._points))

    def points(self, step: int) -> Floats | None:
        """Points of a step and future ones; None if they have not arrived."""
        points = self._points.get(step)
        if points is not None:
            self._points = {later: sent for later, sent in self._points.items() if later > step}
        return points


class NewestPreview:
    """The newest message of a reference force whose loop has a delay of d steps.

    The message of step k contains the points of the steps to k + d; for a target also the motion
    after that. The points of an older message are `extrapolated`. If messages are missing for too
    long, the force is ramped down to zero, a target to its beginning.

    Parameters
    ----------
    section : dict
        Of the force controller. Its ``loop_delay`` is d (negative: not known here); its watchdog
        has the largest age of a message before the ramp begins, without a limit in lockstep.
    axes : int
        n.
    timebase : Timebase
        Sampling clock.

    Attributes
    ----------
    newest : int
        Step of the newest message; -1: none has arrived.

    Raises
    ------
    InputError
        If the watchdog would trip on the loop's own delay.
    """

    def __init__(self, section: dict[str, Any], axes: int, timebase: Timebase) -> None:
        loop_delay, timeout = section["loop_delay"], section["watchdog.reference_timeout"]
        self._patience = round(timeout * timebase.rate)
        if self._patience <= loop_delay:
            delay = f"the loop's own delay is {loop_delay * timebase.dt:g} s (loop_delay)"
            most = f"watchdog.reference_timeout is {timeout:g} s"
            raise InputError(f"force_controller: {most}, but {delay}; make it longer")
        self._axes, self._loop_delay, self._dt = axes, max(loop_delay, 0), timebase.dt
        self._ramp = RampDown.lasting(section["ramp_down_time"], timebase.dt)
        self.reset()

    def reset(self, in_lockstep: bool = False) -> None:
        """Begin a new test: no force before the first message.

        Parameters
        ----------
        in_lockstep : bool
            Whether a step waits for a message with its final force.
        """
        self._in_lockstep = in_lockstep
        self.newest = -1
        self._ages: dict[int, int] = {}
        self._held = 0
        nothing = np.zeros((1 + self._loop_delay, 1, self._axes))
        self._messages = MessagesAhead(self._loop_delay, nothing)
        self._ramp.reset()

    @property
    def is_lost(self) -> bool:
        """Whether the force has been ramped down because messages were missing."""
        return self._ramp.finished

    def report(self) -> LinkReport:
        """Give the ages of the messages of this test."""
        return LinkReport(dict(sorted(self._ages.items())), self._held)

    def take(self, step: int, points: Floats) -> None:
        """Take a message: points of its step and the future ones, shape (p, q, n).

        Raises
        ------
        WireError
            If a newer one has arrived before.
        """
        if step <= self.newest:
            after = f"after that of step {self.newest}: repeated or out of order"
            raise WireError(f"{REFERENCE_FORCE.name} of step {step} {after}")
        self.newest = step
        self._messages.add(step, points)

    def points(self, step: int) -> Floats | None:
        """Points of a step and future ones, shape (p, q, n); None if they must be waited for."""
        newest = step - self.newest
        if self._in_lockstep and newest > self._loop_delay:
            return None
        self._ages[newest] = self._ages.get(newest, 0) + 1
        if newest > self._patience:
            self._ramp.begin()
        age, sent = self._messages.of(step)
        self._held += age >= len(sent)
        points = sent[age:]
        if age > self._loop_delay:
            count = max(len(sent) - self._loop_delay, 1)
            points = extrapolated(sent, age, count, self._dt)
        return points * self._ramp.next() if self._ramp.begun else points
