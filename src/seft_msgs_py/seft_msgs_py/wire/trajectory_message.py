"""A JointTrajectory message taken apart field by field, whatever it holds."""

import struct
from dataclasses import dataclass

from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.timebase import NANOSECONDS_PER_SECOND
from seft_msgs_py.wire.topics import QUANTITIES

ENCAPSULATION = b"\x00\x01\x00\x00"  # CDR, little endian, no options
_MAX_ITEMS = 1_000_000


@dataclass(frozen=True)
class TrajectoryPoint:
    """One point as it stands on the wire; arrays hold as many values as were sent."""

    positions: tuple[float, ...]
    velocities: tuple[float, ...]
    accelerations: tuple[float, ...]
    effort: tuple[float, ...]
    time_from_start_ns: int


@dataclass(frozen=True)
class Trajectory:
    """A JointTrajectory message, taken apart and not yet judged."""

    stamp_ns: int
    frame_id: str
    axes: tuple[str, ...]
    points: tuple[TrajectoryPoint, ...]


def parse_trajectory(raw: bytes, topic: str = "trajectory") -> Trajectory:
    """Take a JointTrajectory message apart, field by field.

    Parameters
    ----------
    raw : bytes
        CDR bytes with their encapsulation header; bytes past the end are ignored, as
        middlewares round sizes up.
    topic : str
        Named in errors.

    Raises
    ------
    WireError
        If the bytes end early, are not little-endian CDR, or hold impossible sizes or text.
    """
    return _Parser(raw, topic).trajectory()


class _Parser:
    def __init__(self, raw: bytes, topic: str) -> None:
        self.raw = raw
        self.topic = topic
        self.at = 4
        if raw[:2] != ENCAPSULATION[:2] or len(raw) < 4:
            raise WireError(
                f"{topic}: {len(raw)} bytes that start with {raw[:4].hex() or 'nothing'} "
                "are no little-endian CDR message"
            )

    def trajectory(self) -> Trajectory:
        seconds, nanoseconds = self.unpack("<iI", 4)
        frame_id = self.string()
        axes = tuple(self.string() for _ in range(self.length(4)))
        points = tuple(self.point() for _ in range(self.length(24)))
        return Trajectory(seconds * NANOSECONDS_PER_SECOND + nanoseconds, frame_id, axes, points)

    def point(self) -> TrajectoryPoint:
        positions, velocities, accelerations, effort = [self.doubles() for _ in QUANTITIES]
        seconds, nanoseconds = self.unpack("<iI", 4)
        time_ns = seconds * NANOSECONDS_PER_SECOND + nanoseconds
        return TrajectoryPoint(positions, velocities, accelerations, effort, time_ns)

    def doubles(self) -> tuple[float, ...]:
        count = self.length(8)
        return self.unpack(f"<{count}d", 8) if count else ()

    def string(self) -> str:
        data = self.take(self.length(1), 1)
        try:
            return data.rstrip(b"\x00").decode()
        except UnicodeDecodeError:
            raise WireError(f"{self.topic}: text at byte {self.at} is not UTF-8") from None

    def length(self, item_size: int) -> int:
        (count,) = self.unpack("<I", 4)
        if count > _MAX_ITEMS or count * item_size > len(self.raw) - self.at:
            raise WireError(
                f"{self.topic}: {count} items claimed at byte {self.at - 4}, but the message "
                f"ends at {len(self.raw)}"
            )
        return int(count)

    def unpack(self, form: str, align: int) -> tuple:  # type: ignore[type-arg]
        return struct.unpack(form, self.take(struct.calcsize(form), align))

    def take(self, size: int, align: int) -> bytes:
        start = self.at + (-(self.at - 4) % align)
        if start + size > len(self.raw):
            raise WireError(f"{self.topic}: the message ends early, at byte {len(self.raw)}")
        self.at = start + size
        return self.raw[start : self.at]
