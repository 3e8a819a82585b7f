"""Commands of a rig: which message determines the command of a step."""

import math
from collections import deque

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.topics import RigAxes
from seft_msgs_py.wire.trajectory import TrajectoryCodec

KEPT_STOPS = 20
"""Fallback stops that a rig keeps: of more than the time in which wrong samples are found."""


def stop_period(dt: float) -> int:
    """Give the steps between two fallback stops: 5 ms, little of a stop."""
    return max(1, round(0.005 / dt))


class MessagesAhead:
    """Points of messages; each step uses those of the message d steps before it.

    So the arrival time of a message has no effect, as long as it is in time. If that message is
    missing, the next one is used; if there is none, the last one. Before the first message the
    points are ``nothing``, as of step -1.
    """

    def __init__(self, loop_delay: int, nothing: Floats) -> None:
        self._loop_delay = loop_delay
        self._messages = deque([(-1, nothing)])

    def add(self, step: int, points: Floats) -> None:
        """Add the message of a step, newer than those before: points of it and later steps."""
        self._messages.append((step, points))

    @property
    def newest(self) -> Floats:
        """Points of the newest message."""
        return self._messages[-1][1]

    def of(self, step: int) -> tuple[int, Floats]:
        """Find the age of the message for a step, in steps, and its points; steps never go back."""
        while len(self._messages) > 1 and self._messages[0][0] < step - self._loop_delay:
            self._messages.popleft()
        first, points = self._messages[0]
        return step - first, points


class Command:
    """Takes the messages of one topic, and keeps the newest valid one.

    A refused message changes nothing: for the rig, its command is missing.

    Parameters
    ----------
    codec : TrajectoryCodec
        Of the topic.
    limit : float
        Largest magnitude on any axis, in the topic's unit.
    loop_delay : int
        A message determines the commands of its step and of so many later steps.
    rig : RigAxes, optional
        The rig that the command is for, if the topic has the axes of several.
    is_plan : bool
        Whether later points of a message are the commands of later steps, and no forecasts.

    Attributes
    ----------
    limit, loop_delay : float, int
        As given.
    unit : str
        Of the command, by default the topic's.
    fastest : float
        Largest change in a step; infinite by default.
    stops_since : int or None
        Step from which on messages are plans: since then their sender brings the rig to rest.
    step : int
        Last step whose command is known; -1: none.
    current : int
        Step of the rig's last sample: no later one can have been answered.
    answered : int
        Step of the sample that the newest message answers; -1: none has arrived.
    """

    def __init__(
        self,
        codec: TrajectoryCodec,
        limit: float,
        loop_delay: int = 0,
        rig: RigAxes | None = None,
        *,
        is_plan: bool = False,
    ) -> None:
        self.codec, self._is_plan = codec, is_plan
        self._rig = rig or RigAxes.whole(codec.axes)
        self._places = None if self._rig.axes == codec.axes else list(self._rig.places)
        self.limit = limit
        self.loop_delay = loop_delay
        self.unit, self.fastest = codec.topic.units[0], math.inf
        self.reset()

    def reset(self) -> None:
        """Back to no drive, before the first sample of a test."""
        self.answered = self.current = -1
        self.step = self.loop_delay - 1
        self.stops_since: int | None = None
        nothing = np.zeros((1 + self.loop_delay, len(self._rig.axes)))
        self._messages = MessagesAhead(self.loop_delay, nothing)
        self._kept: deque[tuple[int, Floats]] = deque(maxlen=KEPT_STOPS)

    @property
    def value(self) -> Floats:
        """Command to be applied after the last sample, shape (n,); zero before the first message.

        If a message has points of later steps, the point of the sample's step is used, or the last.
        """
        age, points = self.newest
        return points[min(age, len(points) - 1)]

    @property
    def newest(self) -> tuple[int, Floats]:
        """Age of the newest message, in steps, and its points, shape (m, n)."""
        return self._messages.of(self.current)

    def plan(self, trusted: int) -> tuple[Floats | None, ...]:
        """Give the newest plan of a trusted step: commands of now and the coming steps, (m, n).

        Also what it has in place of the last command, shape (n,). Nothing if there is no such plan.
        """
        for first, points in reversed(self._kept):
            if first <= trusted:
                age = self.current - first
                return points[age:], points[age - 1] if 0 < age <= len(points) else None
        return ()

    def take(self, raw: bytes) -> None:
        """Take a message.

        Raises
        ------
        WireError
            If it is no command of these axes, is not finite or beyond the limit, answers a
            sample that has not been taken, or is not newer than the present one.
        """
        step, values = self.codec.decode(raw)
        name = self.codec.topic.name
        if step > self.current:
            raise WireError(f"{name} of step {step}, but the rig is at step {self.current}")
        if step <= self.answered:
            after = f"after that of step {self.answered}: stale, duplicated or out of order"
            raise WireError(f"{name} of step {step} {after}")
        settled = values[: None if self._is_plan else 1 + self.loop_delay, 0]
        points = settled if self._places is None else settled[:, self._places]
        worst = points[0] if len(points) == 1 else points[np.abs(points).max(axis=1).argmax()]
        for axis, number in zip(self._rig.axes, worst.tolist(), strict=True):
            if not abs(number) <= self.limit:
                text = f"{number:g} {self.unit} on axis {axis}"
                most = f"beyond the limit of {self.limit:g} {self.unit}"
                raise WireError(f"{name} of step {step} is {text}, {most}")
        if self.fastest < math.inf and self.answered >= 0:
            steps = step - self.answered
            change = np.abs(np.diff(points, axis=0, prepend=self._messages.newest[:1])).max(axis=1)
            if change[0] > self.fastest * steps or change[1:].max(initial=0.0) > self.fastest:
                jump = f"jumps by {change.max():g} {self.unit}"
                most = "more than /**: limits.displacement_rate allows"
                raise WireError(f"{name} of step {step} {jump}, {most}")
        self.answered = step
        if not (self._is_plan and len(points) > 1):
            self.stops_since = None
        elif self.stops_since is None:
            self.stops_since = step
        self._messages.add(step, points)
        self._kept.append((step, points))
        self.step = step + self.loop_delay
