"""Samples of the loop <-> bytes of a trajectory_msgs/msg/JointTrajectory (CDR, little endian).

With known axis names a message has a fixed layout: each double lies on a whole 64-bit word,
counted from the end of the 4-byte encapsulation header, and word 0 is the stamp. `encode` fills
the values into the constant bytes; `decode` compares the constant bytes, except padding, and reads
the values; both handle a message of one point as one long integer. All other messages are parsed
field by field and either understood or refused with a reason. `decode_batch` reads many messages of
equal layout, as a bag holds them, by a few array operations.
"""

import math
import struct
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from seft_msgs_py.arrays import Floats, Ints
from seft_msgs_py.errors import WireError
from seft_msgs_py.wire import topics
from seft_msgs_py.wire.messages import decode_message, nanoseconds
from seft_msgs_py.wire.topics import LoopTopic, Timebase

ENCAPSULATION = b"\x00\x01\x00\x00"  # CDR, little endian, no options
STAMP = struct.Struct("<iI")


class Layout(NamedTuple):
    """A message of given axes, quantities and number of points.

    Attributes
    ----------
    template : bytes
        The message at time 0, all values zero.
    known, constant : bytes
        Ones where bits are constant, and these bits.
    mask, fixed : int
        The same as one number each.
    values : ndarray of intp
        Shape (p, q, n): words that hold the values of points, quantities, axes.
    shapes : tuple
        Shapes of arrays from which it can be filled, that of ``values`` first.
    numbers : struct.Struct
        The stamp and, in a message of one point, the values.
    points_at : int
        Byte offset of the number of points.
    """

    template: bytes
    known: bytes
    constant: bytes
    mask: int
    fixed: int
    values: npt.NDArray[np.intp]
    shapes: tuple[tuple[int, ...], ...]
    numbers: struct.Struct
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
        """Lay out a message of ``count`` samples, a period apart.

        Its points may have more arrays than those of the topic: ``carried``.
        """
        message, known = bytearray(ENCAPSULATION), bytearray(b"\xff" * len(ENCAPSULATION))

        def put(data: bytes, align: int = 4, fixed: bool = True) -> int:
            padding = -(len(message) - len(ENCAPSULATION)) % align
            message.extend(bytes(padding) + data)
            known.extend(bytes(padding) + (b"\xff" if fixed else b"\x00") * len(data))
            return len(message) - len(data)

        def put_string(text: str) -> None:
            data = text.encode() + b"\x00"
            put(struct.pack("<I", len(data)))
            put(data, align=1)

        points, values = topic.points(count), []
        put(bytes(STAMP.size), fixed=False)
        put_string("")
        put(struct.pack("<I", len(axes)))
        for axis in axes:
            put_string(axis)
        points_at = put(struct.pack("<I", len(points)))
        form, end = "<4xiI", 12
        for point, arrays in enumerate(points):
            for quantity in topics.QUANTITIES:
                held = axes if quantity in arrays or quantity in carried else ()
                put(struct.pack("<I", len(held)))
                at = [put(bytes(8), align=8, fixed=False) for _ in held]
                if quantity not in arrays:
                    continue
                values += at
                if count == 1:
                    form += f"{at[0] - end}x{len(at)}d"
                    end = at[-1] + 8
            put(STAMP.pack(*divmod(timebase.stamp_ns(point), topics.NANOSECONDS_PER_SECOND)))
        mask, q, n = int.from_bytes(known, "little"), len(topic.quantities), len(axes)
        fixed = int.from_bytes(message, "little") & mask
        words = (np.array(values).reshape(-1, q, n) - 4) // 8
        count = len(words)
        single = ((q, n),) if count == 1 else ()
        flat = ((count, n), (n,)) if count == q == 1 else ((count, n),) if q == 1 else ()
        return cls(
            template=bytes(message),
            known=bytes(known),
            constant=fixed.to_bytes(len(message), "little"),
            mask=mask,
            fixed=fixed,
            values=words,
            shapes=((count, q, n), *single, *flat),
            numbers=struct.Struct(f"{form}{len(message) - end}x"),
            points_at=points_at,
        )

    def fits(self, raw: bytes) -> bool:
        """Say whether a message differs from the template in stamp, values and padding alone."""
        size = len(self.template)
        if len(raw) < size:
            return False
        if len(self.values) == 1:  # of a short message one number is faster than arrays
            return int.from_bytes(raw[:size], "little") & self.mask == self.fixed
        known = np.frombuffer(raw, "<u4", size // 4) & np.frombuffer(self.known, "<u4")
        return known.tobytes() == self.constant


_Bytes = npt.NDArray[np.uint8]
_Flags = npt.NDArray[np.bool_]

_COUNTS = struct.Struct("<II")  # of points, and of the first's positions


class TrajectoryCodec:
    """Samples of one loop topic over n axes <-> message bytes.

    The topic defines which q arrays of a point have values, the time base the stamp of a step.
    """

    def __init__(self, topic: LoopTopic, axes: Sequence[str], timebase: Timebase) -> None:
        self.topic = topic
        self.axes = tuple(axes)
        self.timebase = timebase
        self._layouts: dict[tuple[int, tuple[str, ...]], Layout] = {}
        self._single = self._layout(1)
        self._points_of_one = len(topic.points(1))

    def encode(self, step: int, values: Floats) -> bytes:
        """Make the message of a sample, of shape (q, n), or (n,) where q is 1.

        Raises
        ------
        WireError
            If shape or type do not fit, or a value is not finite.
        """
        return self._encode(self._single, step, values)

    def encode_points(self, step: int, values: Floats) -> bytes:
        """Make the message of a sample and its known future, one point a step, see `encode`.

        The points from ``step`` on have shape (p, q, n), or (p, n) where q is 1.
        """
        count = len(values) if isinstance(values, np.ndarray) and values.ndim else 1
        if count == 0:
            raise WireError(f"{self.topic.name}: a message needs at least one point")
        return self._encode(self._layout(count), step, values)

    def decode(self, raw: bytes) -> tuple[int, Floats]:
        """Read a message: step of its first point, and values of shape (p, q, n).

        They are finite, unless the topic allows others.

        Raises
        ------
        WireError
            If the bytes are no such message, or not of these axes, quantities and steps.
        """
        layout = self.layout_of(raw)
        if not layout.fits(raw):
            return self._decode_slowly(raw)
        seconds, nanoseconds, *numbers = layout.numbers.unpack_from(raw)
        if numbers:
            values = np.array(numbers).reshape(layout.values.shape)
        else:
            values = np.frombuffer(raw, "<f8", (len(layout.template) - 4) // 8, 4)[layout.values]
        self._check_finite(numbers, values)
        return self.timebase.step(seconds * topics.NANOSECONDS_PER_SECOND + nanoseconds), values

    def _encode(self, layout: Layout, step: int, values: Floats) -> bytes:
        if not isinstance(values, np.ndarray) or values.dtype != np.float64:
            kind, of = type(values).__name__, getattr(values, "dtype", None)
            found = kind if of is None else f"{kind} of {of}"
            raise WireError(f"{self.topic.name}: values must be a float64 array, not {found}")
        if values.shape not in layout.shapes:
            raise WireError(
                f"{self.topic.name}: values have shape {values.shape}, not {layout.shapes[0]} "
                f"(points, {'/'.join(self.topic.quantities)}, axes)"
            )
        values = values.reshape(layout.shapes[0])
        numbers = values.ravel().tolist() if layout is self._single else []
        self._check_finite(numbers, values)
        stamp = divmod(self.timebase.stamp_ns(step), topics.NANOSECONDS_PER_SECOND)
        if numbers:
            varying = int.from_bytes(layout.numbers.pack(*stamp, *numbers), "little")
            return (varying | layout.fixed).to_bytes(len(layout.template), "little")
        message = bytearray(layout.template)
        STAMP.pack_into(message, 4, *stamp)
        np.frombuffer(message, "<f8", (len(message) - 4) // 8, 4)[layout.values] = values
        return bytes(message)

    def _layout(self, count: int, carried: tuple[str, ...] = ()) -> Layout:
        if (layout := self._layouts.get((count, carried))) is None:
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
        if first and self.topic.name == topics.TARGET.name:
            return self._layout(count, topics.TARGET.quantities)
        return single if count == self._points_of_one else self._layout(count)

    def _check_finite(self, numbers: Sequence[float], values: Floats) -> None:
        """Check values of shape (p, q, n), faster if they are also given as numbers."""
        if numbers and math.hypot(*numbers) < math.inf:
            return
        if self.topic.finite and not np.isfinite(values).all():
            point, row, column = np.argwhere(~np.isfinite(values))[0]
            raise WireError(
                f"{self.topic.name}: {self.topic.quantities[row]} of axis {self.axes[column]} is "
                f"{values[point, row, column]}"
            )

    def _decode_slowly(self, raw: bytes) -> tuple[int, Floats]:
        """Parse a message field by field; bytes past its end, which DDS adds, are ignored."""
        name = self.topic.name
        if raw[:2] != ENCAPSULATION[:2] or len(raw) < 4:
            start = bytes(raw[:4]).hex() or "nothing"
            what = f"{len(raw)} bytes that start with {start}"
            raise WireError(f"{name}: {what} are no little-endian CDR message")
        message = decode_message(topics.JOINT_TRAJECTORY, raw, name)
        if message.joint_names != list(self.axes):
            wanted = f"{list(self.axes)} as configured"
            raise WireError(f"{name}: axes are {message.joint_names}, not {wanted}")
        if not message.points:
            raise WireError(f"{name}: the message holds no point")
        points = self.topic.points(len(message.points))
        if len(points) != len(message.points):
            raise WireError(
                f"{name}: points {len(message.points)}, not {len(points)}: the sample, and whether "
                "it is suspect with the effort that the rig applies from then on"
            )
        numbers: list[float] = []
        for index, (point, arrays) in enumerate(zip(message.points, points, strict=True)):
            after = nanoseconds(point.time_from_start)
            if after != self.timebase.stamp_ns(index):
                raise WireError(
                    f"{name}: point {index} is {after} ns after the stamp, "
                    f"not {self.timebase.stamp_ns(index)} ns ({index} steps)"
                )
            for quantity in arrays:
                given = getattr(point, quantity)
                if len(given) != len(self.axes):
                    raise WireError(
                        f"{name}: {len(given)} {quantity} for {len(self.axes)} axes "
                        f"{list(self.axes)}"
                    )
                numbers.extend(given)
        values = np.array(numbers).reshape(-1, len(self.topic.quantities), len(self.axes))
        self._check_finite([], values)
        return self.timebase.step(nanoseconds(message.header.stamp)), values


class _Batch(NamedTuple):
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

    steps: Ints
    values: Floats
    messages: Ints
    refused: int

    def up_to(self, ahead: float) -> "_Batch":
        """Leave out points that are more than ``ahead`` steps after the first of their message."""
        first = np.searchsorted(self.messages, self.messages)
        near = np.arange(len(self.steps)) - first <= ahead
        if near.all():
            return self
        return _Batch(self.steps[near], self.values[near], self.messages[near], self.refused)


def decode_batch(codec: TrajectoryCodec, rows: _Bytes) -> _Batch:
    """Read M messages of equal length, shape (M, length), as `TrajectoryCodec.decode` does each.

    Those with the layout of the first one differ only in stamp and doubles; all others are decoded
    one by one. The memory needed is a small multiple of theirs.
    """
    layout = codec.layout_of(rows[0].tobytes() if len(rows) else b"")
    steps, values, fits = _of_layout(codec, rows, layout)
    points, *shape = layout.values.shape
    every = steps[:, np.newaxis] + np.arange(points)
    kept = np.flatnonzero(fits)
    parts: list[tuple[Ints, Floats, Ints]] = [
        (every[kept].ravel(), values[kept].reshape(-1, *shape), np.repeat(kept, points))
    ]
    refused = 0
    for number in np.flatnonzero(~fits).tolist():
        try:
            step, single = codec.decode(rows[number].tobytes())
        except WireError:
            refused += 1
        else:
            count = len(single)
            parts.append((step + np.arange(count), single, np.full(count, number)))
    if len(parts) == 1:  # the usual case: all messages have the layout
        return _Batch(*parts[0], refused)
    found, points_of, messages = map(np.concatenate, zip(*parts, strict=True))
    order = np.argsort(messages, kind="stable")
    return _Batch(found[order], points_of[order], messages[order], refused)


def _of_layout(codec: TrajectoryCodec, rows: _Bytes, layout: Layout) -> tuple[Ints, Floats, _Flags]:
    """Read messages as if they had a layout: steps, values, and which of them are valid so."""
    (count, length), size = rows.shape, len(layout.template)
    if not count or length < size:
        nothing = np.zeros(count, np.int64)
        return nothing, np.empty((count, layout.values.size)), nothing.astype(bool)
    seconds = rows[:, 4:8].copy().view("<i4")[:, 0].astype(np.int64)
    nanoseconds = rows[:, 8:12].copy().view("<u4")[:, 0]
    steps, fits = codec.timebase.steps(seconds * topics.NANOSECONDS_PER_SECOND + nanoseconds)
    words = np.ndarray((count, (size - 4) // 8), "<f8", rows, 4, (length, 8))
    values = words[:, layout.values.ravel()]
    differing = rows[:, :size] & np.frombuffer(layout.known, np.uint8)
    differing ^= np.frombuffer(layout.constant, np.uint8)
    fits &= ~differing.any(axis=1)
    if codec.topic.finite:
        fits &= np.isfinite(values).all(axis=1)
    return steps, values, fits
