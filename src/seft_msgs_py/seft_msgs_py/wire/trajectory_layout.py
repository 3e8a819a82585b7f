"""JointTrajectory messages: the layout of known ones, and the fields of any."""

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.messages import decode_message, nanoseconds
from seft_msgs_py.wire.timebase import NANOSECONDS_PER_SECOND, Timebase
from seft_msgs_py.wire.topics import JOINT_TRAJECTORY, QUANTITIES, LoopTopic

ENCAPSULATION = b"\x00\x01\x00\x00"  # CDR, little endian, no options
STAMP = struct.Struct("<iI")


@dataclass(frozen=True)
class Layout:
    """A message of given axes, quantities and number of points, in 64-bit words.

    Words are counted from the end of the encapsulation header; word 0 is the stamp.

    Attributes
    ----------
    template : bytes
        The message at time 0, all values zero.
    size, words : int
        Its bytes, and its whole words.
    tail : bytes
        Bytes after the last whole word.
    values : ndarray of intp
        Shape (p, q, n): words that hold the values of points, quantities, axes.
    mask, fixed : ndarray of uint64
        Shape (words,): ones where bits are constant, and these bits.
    points_at : int
        Byte offset of the number of points.
    """

    template: bytes
    size: int
    words: int
    tail: bytes
    values: npt.NDArray[np.intp]
    mask: npt.NDArray[np.uint64]
    fixed: npt.NDArray[np.uint64]
    points_at: int

    @classmethod
    def of(
        cls,
        topic: LoopTopic,
        axes: tuple[str, ...],
        timebase: Timebase,
        count: int,
        carried: tuple[str, ...],
    ) -> "Layout":
        """Lay out a message of ``count`` points, a period apart.

        Its points have the quantities ``carried``: those of the topic, and perhaps others.
        """
        message, known = bytearray(ENCAPSULATION), bytearray(4)

        def put(data: bytes, align: int = 4, fixed: bool = True) -> int:
            padding = -(len(message) - 4) % align
            message.extend(bytes(padding) + data)
            known.extend(bytes(padding) + (b"\xff" if fixed else b"\x00") * len(data))
            return len(message) - len(data)

        def put_string(text: str) -> None:
            data = text.encode() + b"\x00"
            put(struct.pack("<I", len(data)))
            put(data, align=1)

        put(bytes(8), fixed=False)
        put_string("")
        put(struct.pack("<I", len(axes)))
        for axis in axes:
            put_string(axis)
        points_at = put(struct.pack("<I", count))
        values = np.empty((count, len(topic.quantities), len(axes)), np.intp)
        for point in range(count):
            for quantity in QUANTITIES:
                if quantity not in carried:
                    put(struct.pack("<I", 0))
                    continue
                put(struct.pack("<I", len(axes)))
                at = [put(bytes(8), align=8, fixed=False) for _ in axes]
                if quantity in topic.quantities:
                    row = topic.quantities.index(quantity)
                    values[point, row] = (np.array(at) - 4) // 8
            put(STAMP.pack(*divmod(point * timebase.period_ns, NANOSECONDS_PER_SECOND)))
        size = len(message)
        words = (size - 4) // 8
        mask = np.frombuffer(bytes(known), "<u8", words, 4)
        fixed_words = np.frombuffer(bytes(message), "<u8", words, 4) & mask
        return cls(
            template=bytes(message),
            size=size,
            words=words,
            tail=bytes(message[4 + 8 * words :]),
            values=values,
            mask=mask,
            fixed=fixed_words,
            points_at=points_at,
        )


@dataclass(frozen=True)
class TrajectoryPoint:
    """One point as it is on the wire; arrays hold as many values as were sent."""

    positions: tuple[float, ...]
    velocities: tuple[float, ...]
    accelerations: tuple[float, ...]
    effort: tuple[float, ...]
    time_from_start_ns: int


@dataclass(frozen=True)
class Trajectory:
    """All fields of a JointTrajectory message, not yet checked against a test."""

    stamp_ns: int
    frame_id: str
    axes: tuple[str, ...]
    points: tuple[TrajectoryPoint, ...]


def parse_trajectory(raw: bytes, topic: str = "trajectory") -> Trajectory:
    """Read all fields of a JointTrajectory message; errors name the topic.

    Bytes past the end are ignored, because middlewares round sizes up.

    Raises
    ------
    WireError
        If the bytes end early, are not little-endian CDR, or hold impossible sizes or text.
    """
    if raw[:2] != ENCAPSULATION[:2] or len(raw) < 4:
        raise WireError(
            f"{topic}: {len(raw)} bytes that start with {bytes(raw[:4]).hex() or 'nothing'} "
            "are no little-endian CDR message"
        )
    message = decode_message(JOINT_TRAJECTORY, raw, topic)
    points = []
    for point in message.points:
        fields: dict[str, Any] = {name: tuple(getattr(point, name).tolist()) for name in QUANTITIES}
        fields["time_from_start_ns"] = nanoseconds(point.time_from_start)
        points.append(TrajectoryPoint(**fields))
    header, axes = message.header, tuple(message.joint_names)
    return Trajectory(nanoseconds(header.stamp), header.frame_id, axes, tuple(points))
