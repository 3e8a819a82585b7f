"""Commands that a rig must not act upon."""

import struct
from dataclasses import dataclass

import numpy as np
from seft_msgs_py.wire.timebase import Timebase
from seft_msgs_py.wire.topics import LoopTopic
from seft_msgs_py.wire.trajectory import TrajectoryCodec

SETTLE, BLOCK = 0.1, 0.1  # s of rest before each kind, and of the kind
KINDS = (
    "stale",
    "a second time",
    "of the future",
    "of another axis",
    "not a number",
    "between two steps",
)
BESIDE = ("stale", "a second time")
"""Kinds that are sent after the step's own command; the others in its place, every other step."""


@dataclass(frozen=True)
class BadCommands:
    """Which command answers which step of a test in which most are bad.

    Attributes
    ----------
    topic : LoopTopic
        What drives the rig.
    axes : tuple of str
        Names of the n axes.
    timebase : Timebase
        Sampling clock.
    value : float
        What the bad ones ask for, in the topic's unit; the good ones ask for 0.
    """

    topic: LoopTopic
    axes: tuple[str, ...]
    timebase: Timebase
    value: float

    @property
    def steps(self) -> int:
        """Steps of the test."""
        return self.block(len(KINDS) - 1).stop + self._settle

    @property
    def _settle(self) -> int:
        return max(4, round(SETTLE / self.timebase.dt))

    def block(self, kind: int) -> slice:
        """Give the steps of a kind of command."""
        length = max(10, round(BLOCK / self.timebase.dt))
        start = self._settle + kind * (self._settle + length)
        return slice(start, start + length)

    def answers(self, step: int) -> list[bytes]:
        """Give the messages that answer a step."""
        codec = TrajectoryCodec(self.topic, self.axes, self.timebase)
        good = codec.encode(step, np.zeros(len(self.axes)))
        for number, kind in enumerate(KINDS):
            block = self.block(number)
            if block.start <= step < block.stop:
                bad = self._bad(kind, step, codec)
                if kind in BESIDE:
                    return [good, bad]
                return [bad] if (step - block.start) % 2 else [good]
        return [good]

    def _bad(self, kind: str, step: int, codec: TrajectoryCodec) -> bytes:
        value = np.full(len(self.axes), self.value)
        if kind == "stale":
            return codec.encode(max(0, step - 3), value)
        if kind == "a second time":
            return codec.encode(step, value)
        if kind == "of the future":
            return codec.encode(step + 1000, value)
        if kind == "of another axis":
            others = tuple(f"{axis}_other" for axis in self.axes)
            return TrajectoryCodec(self.topic, others, self.timebase).encode(step, value)
        raw = codec.encode(step, value)
        if kind == "not a number":
            return raw.replace(struct.pack("<d", self.value), struct.pack("<d", float("nan")))
        (nanoseconds,) = struct.unpack_from("<I", raw, 8)
        return raw[:8] + struct.pack("<I", nanoseconds + 1) + raw[12:]
