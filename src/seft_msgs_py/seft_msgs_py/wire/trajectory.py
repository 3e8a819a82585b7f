"""Samples of the loop <-> bytes of a trajectory_msgs/msg/JointTrajectory (CDR, little endian).

With known axis names a message has a fixed layout: each double lies on a whole 64-bit word,
counted from the end of the 4-byte encapsulation header, and word 0 is the stamp. `encode` fills
the values into the constant bytes; `decode` compares the constant bytes, except padding, and reads
the values. Messages of one point, which the loop sends, are handled as one long integer; those of
several points word by word. All other messages are parsed field by field and either understood or
refused with a reason. `decode_batch` reads many messages of equal layout, as a bag holds them, by a
few array operations.
"""

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from seft_msgs_py.arrays import Floats
from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.messages import decode_message, nanoseconds
from seft_msgs_py.wire.topics import (
    JOINT_TRAJECTORY,
    NANOSECONDS_PER_SECOND,
    QUANTITIES,
    TARGET,
    LoopTopic,
    Timebase,
)

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


Steps = npt.NDArray[np.int64]
Bytes = npt.NDArray[np.uint8]
Flags = npt.NDArray[np.bool_]

_COUNTS = struct.Struct("<II")  # of points, and of the first's positions
_FLOAT64 = np.dtype(np.float64)


class TrajectoryCodec:
    """Samples of one loop topic over n axes <-> message bytes.

    The topic defines which q arrays of a point have values, the time base the stamp of a step.
    """

    def __init__(self, topic: LoopTopic, axes: Sequence[str], timebase: Timebase) -> None:
        self.topic = topic
        self.axes = tuple(axes)
        self.timebase = timebase
        self._period_ns = timebase.period_ns
        self._layouts: dict[tuple[int, tuple[str, ...]], Layout] = {}
        self._single = single = self._layout(1)
        shape = single.values.shape
        self._single_shapes = _shapes(*shape)
        # one point as a long integer: its constant bits, and their mask
        fixed = b"\xff" * 4 + single.mask.tobytes() + b"\xff" * len(single.tail)
        self._mask = int.from_bytes(fixed, "little")
        self._fixed = int.from_bytes(single.template, "little") & self._mask
        self._numbers = _struct_of_numbers(single)  # and the stamp before them
        rows = (4 + 8 * single.values[0, :, 0]).tolist()
        self._first_row = rows[0]
        stride = rows[1] - rows[0] if len(rows) > 1 else 8 * len(self.axes)
        self._single_strides = (stride * len(rows), stride, 8)

    def encode(self, step: int, values: Floats) -> bytes:
        """Make the message of a sample, of shape (q, n), or (n,) where q is 1.

        Raises
        ------
        WireError
            If shape or type do not fit, or a value is not finite.
        """
        if (
            values.__class__ is not np.ndarray
            or values.dtype is not _FLOAT64
            or values.shape not in self._single_shapes
            or not math.hypot(*(numbers := values.ravel().tolist())) < math.inf
        ):
            return self._encode(self._single, step, values)
        stamp = divmod(step * self._period_ns, NANOSECONDS_PER_SECOND)
        varying = int.from_bytes(self._numbers.pack(*stamp, *numbers), "little")
        return (varying | self._fixed).to_bytes(self._single.size, "little")

    def encode_points(self, step: int, values: Floats) -> bytes:
        """Make the message of a sample and its known future, one point a step, see `encode`.

        The points from ``step`` on have shape (p, q, n), or (p, n) where q is 1.
        """
        count = len(values) if isinstance(values, np.ndarray) and values.ndim else 1
        if count == 0:
            raise WireError(f"{self.topic.name}: a message needs at least one point")
        return self._encode(self._layout(count), step, values)

    def decode(self, raw: bytes) -> tuple[int, Floats]:
        """Read a message: step of its first point, and finite values of shape (p, q, n).

        Raises
        ------
        WireError
            If the bytes are no such message, or not of these axes, quantities and steps.
        """
        single = self._single
        if len(raw) == single.size and int.from_bytes(raw, "little") & self._mask == self._fixed:
            seconds, nanoseconds, *numbers = self._numbers.unpack(raw)
            if math.hypot(*numbers) < math.inf:
                shape, strides = self._single_shapes[0], self._single_strides
                values = np.ndarray(shape, _FLOAT64, raw, self._first_row, strides)
                stamp = seconds * NANOSECONDS_PER_SECOND + nanoseconds
                return self.timebase.step(stamp), values
        return self._decode_any(raw)

    def _decode_any(self, raw: bytes) -> tuple[int, Floats]:
        layout = self.layout_of(raw)
        if len(raw) < layout.size or raw[:4] != ENCAPSULATION:
            return self._decode_slowly(raw)
        body = np.frombuffer(raw, "<u8", layout.words, 4)
        tail = raw[4 + body.nbytes : layout.size]
        if tail != layout.tail or np.count_nonzero((body & layout.mask) ^ layout.fixed):
            return self._decode_slowly(raw)
        seconds, nanoseconds = STAMP.unpack_from(raw, 4)
        values = body.view(np.float64)[layout.values]
        self._check_finite(values)
        return self.timebase.step(seconds * NANOSECONDS_PER_SECOND + nanoseconds), values

    def _encode(self, layout: Layout, step: int, values: Floats) -> bytes:
        if not isinstance(values, np.ndarray) or values.dtype != np.float64:
            kind, of = type(values).__name__, getattr(values, "dtype", None)
            found = kind if of is None else f"{kind} of {of}"
            raise WireError(f"{self.topic.name}: values must be a float64 array, not {found}")
        shape = layout.values.shape
        if values.shape not in _shapes(*shape):
            raise WireError(
                f"{self.topic.name}: values have shape {values.shape}, not {shape} "
                f"(points, {'/'.join(self.topic.quantities)}, axes)"
            )
        values = values.reshape(shape)
        self._check_finite(values)
        message = bytearray(layout.template)
        STAMP.pack_into(message, 4, *divmod(step * self.timebase.period_ns, NANOSECONDS_PER_SECOND))
        np.frombuffer(message, "<f8", layout.words, 4)[layout.values] = values
        return bytes(message)

    def _layout(self, count: int, carried: tuple[str, ...] = ()) -> Layout:
        carried = carried or self.topic.quantities
        layout = self._layouts.get((count, carried))
        if layout is None:
            if len(self._layouts) > 64:
                self._layouts.clear()
            layout = Layout.of(self.topic, self.axes, self.timebase, count, carried)
            self._layouts[count, carried] = layout
        return layout

    def layout_of(self, raw: bytes) -> Layout:
        """Layout of as many points as a message claims; of one, if that number is impossible.

        A message may carry a target where only the reference force is read.
        """
        single = self._single
        at = single.points_at
        if len(raw) < at + 8:
            return single
        count, first = _COUNTS.unpack_from(raw, at)
        if not 1 <= count <= len(raw) // 24:
            return single
        if first and self.topic.name == TARGET.name:
            return self._layout(count, TARGET.quantities)
        return single if count == 1 else self._layout(count)

    def _check_finite(self, values: Floats) -> None:
        if not np.isfinite(values).all():
            point, row, column = np.argwhere(~np.isfinite(values))[0]
            raise WireError(
                f"{self.topic.name}: {self.topic.quantities[row]} of axis {self.axes[column]} is "
                f"{values[point, row, column]}"
            )

    def _decode_slowly(self, raw: bytes) -> tuple[int, Floats]:
        message = parse_trajectory(raw, self.topic.name)
        name = self.topic.name
        if message.axes != self.axes:
            raise WireError(
                f"{name}: axes are {list(message.axes)}, not {list(self.axes)} as configured"
            )
        if not message.points:
            raise WireError(f"{name}: the message holds no point")
        values = np.empty((len(message.points), len(self.topic.quantities), len(self.axes)))
        for index, point in enumerate(message.points):
            if point.time_from_start_ns != index * self.timebase.period_ns:
                raise WireError(
                    f"{name}: point {index} is {point.time_from_start_ns} ns after the stamp, "
                    f"not {index} periods of {self.timebase.period_ns} ns"
                )
            for row, quantity in enumerate(self.topic.quantities):
                given = getattr(point, quantity)
                if len(given) != len(self.axes):
                    raise WireError(
                        f"{name}: {len(given)} {quantity} for {len(self.axes)} axes "
                        f"{list(self.axes)}"
                    )
                values[index, row] = given
        self._check_finite(values)
        return self.timebase.step(message.stamp_ns), values


def _shapes(p: int, q: int, n: int) -> tuple[tuple[int, ...], ...]:
    """List the allowed shapes of p points of q quantities over n axes, the full one first."""
    single = ((q, n),) if p == 1 else ()
    flat = ((p, n), (n,)) if p == q == 1 else ((p, n),) if q == 1 else ()
    return ((p, q, n), *single, *flat)


def _struct_of_numbers(layout: Layout) -> struct.Struct:
    """Struct of the stamp and the doubles of a message, in their order."""
    form, end = f"<{len(ENCAPSULATION)}x{STAMP.format.lstrip('<')}", len(ENCAPSULATION) + STAMP.size
    for word in layout.values.ravel().tolist():
        at = 4 + 8 * word
        form += f"{at - end}xd"
        end = at + 8
    return struct.Struct(f"{form}{layout.size - end}x")


class Batch(NamedTuple):
    """Content of many messages.

    Attributes
    ----------
    steps : ndarray of int64
        Shape (N,): steps of all points of all valid messages, in their order.
    values : ndarray
        Shape (N, q, n): points, quantities, axes. All finite.
    messages : ndarray of int64
        Shape (N,): index of each point's message.
    refused : int
        Number of invalid messages.
    """

    steps: Steps
    values: Floats
    messages: Steps
    refused: int

    def up_to(self, ahead: float) -> "Batch":
        """Leave out points that are more than ``ahead`` steps after the first of their message."""
        first = np.searchsorted(self.messages, self.messages)
        near = np.arange(len(self.steps)) - first <= ahead
        if near.all():
            return self
        return Batch(self.steps[near], self.values[near], self.messages[near], self.refused)


def decode_batch(codec: TrajectoryCodec, rows: Bytes) -> Batch:
    """Read M messages of equal length, shape (M, length), as `TrajectoryCodec.decode` does each.

    Those with the layout of the first one differ only in stamp and doubles; all others are decoded
    one by one. The memory needed is a small multiple of theirs.
    """
    count, length = rows.shape
    layout = codec.layout_of(rows[0].tobytes() if count else b"")
    points, *shape = layout.values.shape
    values = np.empty((count, layout.values.size))
    steps, fits = np.zeros(count, np.int64), np.zeros(count, bool)
    if length >= layout.size and count:
        steps, fits = _steps(codec, rows)
        words = np.ndarray((count, layout.words), "<u8", rows, 4, (length, 8))
        values = words[:, layout.values.ravel()].view(np.float64)
        fits &= np.isfinite(values).all(axis=1) & _as_laid_out(rows, words, layout)
    every = steps[:, np.newaxis] + np.arange(points)
    nothing = np.empty((0, len(codec.topic.quantities), len(codec.axes)))
    parts: list[tuple[Steps, Floats, Steps]] = [
        (np.empty(0, np.int64), nothing, np.empty(0, np.int64))
    ]
    refused, start = 0, 0
    for end in [*np.flatnonzero(~fits).tolist(), count]:
        if start < end:
            messages = np.repeat(np.arange(start, end), points)
            points_of = values[start:end].reshape(-1, *shape)
            parts.append((every[start:end].ravel(), points_of, messages))
        if end < count:
            try:
                step, single = codec.decode(rows[end].tobytes())
            except WireError:
                refused += 1
            else:
                number = len(single)
                parts.append((step + np.arange(number), single, np.full(number, end)))
        start = end + 1
    if len(parts) == 2:  # the usual case: all messages have the layout
        return Batch(*parts[1], refused)
    found, points_of, messages_of = map(np.concatenate, zip(*parts, strict=True))
    return Batch(found, points_of, messages_of, refused)


def _as_laid_out(rows: Bytes, words: npt.NDArray[np.uint64], layout: Layout) -> Flags:
    """Whether each message has the constant bits of a layout."""
    checked = np.flatnonzero(layout.mask)
    differing = words[:, checked]
    differing &= layout.mask[checked]
    differing ^= layout.fixed[checked]
    headed = rows[:, : len(ENCAPSULATION)] == np.frombuffer(ENCAPSULATION, np.uint8)
    tail = rows[:, layout.size - len(layout.tail) : layout.size] == list(layout.tail)
    found: Flags = np.bitwise_or.reduce(differing, axis=1) == 0
    return found & headed.all(axis=1) & tail.all(axis=1)


def _steps(codec: TrajectoryCodec, rows: Bytes) -> tuple[Steps, Flags]:
    """Read the stamps of messages: their steps, and which of them are on the grid."""
    seconds = rows[:, 4:8].copy().view("<i4")[:, 0].astype(np.int64)
    nanoseconds = rows[:, 8:12].copy().view("<u4")[:, 0]
    steps, rest = np.divmod(
        seconds * NANOSECONDS_PER_SECOND + nanoseconds, codec.timebase.period_ns
    )
    return steps, (rest == 0) & (steps >= 0)
