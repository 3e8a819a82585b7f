"""What was heard of a rig in one piece of the conformance test."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.messages import Status
from seft_msgs_py.wire.trajectory import Floats, TrajectoryCodec


@dataclass
class Trial:
    """Messages of the rig, as they came; times are monotonic, in s.

    Attributes
    ----------
    states : list of (float, bytes)
        When each rig/state came, and the message.
    sent : list of float
        When each was sent: what this host is late in taking is none of the rig's doing.
    statuses : list of (float, Status)
        What the rig told in its diagnostics.
    clocks : list of (float, int)
        When /clock came, and its time, ns.
    commands : dict of int to (float, ndarray)
        Step -> when its command was sent, and what it was, shape (n,).
    marks : dict of str to float
        When something was done to the rig.
    fault : str
        Why it was broken off; else empty.
    stalls : list of (float, float)
        When this host stood still, where that was watched: begin and end.
    """

    states: list[tuple[float, bytes]] = field(default_factory=list)
    sent: list[float] = field(default_factory=list)
    statuses: list[tuple[float, Status]] = field(default_factory=list)
    clocks: list[tuple[float, int]] = field(default_factory=list)
    commands: dict[int, tuple[float, Floats]] = field(default_factory=dict)
    marks: dict[str, float] = field(default_factory=dict)
    fault: str = ""
    stalls: list[tuple[float, float]] = field(default_factory=list)

    def status_of(self, phase: str) -> tuple[float, Status] | None:
        """Give the first status in which the rig told a phase, and when; None if it did not."""
        return next((s for s in self.statuses if s[1].values.get("phase") == phase), None)

    @property
    def phase(self) -> str:
        """Last phase that the rig told; empty if none."""
        return self.statuses[-1][1].values.get("phase", "") if self.statuses else ""

    def states_after(self, mark: str) -> list[float]:
        """Give the times of the states that came after something was done, s since then."""
        at = self.marks[mark]
        return [time - at for time, _ in self.states if time > at]


@dataclass(frozen=True)
class Samples:
    """States that could be read, in the order in which they came.

    Attributes
    ----------
    steps : ndarray of int64
        Shape (N,).
    values : ndarray
        Shape (N, 4, n).
    times : ndarray
        When they were sent, s, shape (N,).
    """

    steps: npt.NDArray[np.int64]
    values: Floats
    times: Floats

    @classmethod
    def of(cls, trial: Trial, codec: TrajectoryCodec) -> "Samples":
        """Read the states of a trial; those that can't be read are left out."""
        rows: list[tuple[int, Any, float]] = []
        for (_, raw), at in zip(trial.states, trial.sent, strict=True):
            try:
                step, values = codec.decode(raw)
            except WireError:
                continue
            rows.append((step, values[0], at))
        if not rows:
            none = np.empty((0, len(codec.topic.quantities), len(codec.axes)))
            return cls(np.empty(0, np.int64), none, np.empty(0))
        columns = ([row[column] for row in rows] for column in range(3))
        steps, values, times = (np.array(column) for column in columns)
        return cls(steps, values, times)
