"""Samples of the loop <-> bytes of a trajectory_msgs/msg/JointTrajectory (CDR, little endian).

A message with known axis names has a fixed layout, in which every double stands on a whole
64-bit word counted from the end of the 4-byte encapsulation header, and the stamp is word 0.
Encoding writes the words that vary into a prepared message; decoding checks that all other
words are as prepared (padding aside: its bytes are arbitrary on the wire) and reads those.
Anything else is taken apart field by field, to be understood or refused with a reason.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from seft_msgs_py.errors import WireError
from seft_msgs_py.timebase import NANOSECONDS_PER_SECOND, Timebase
from seft_msgs_py.topics import QUANTITIES, LoopTopic

Floats = npt.NDArray[np.float64]

ENCAPSULATION = b"\x00\x01\x00\x00"  # CDR, little endian, no options
_STAMP = struct.Struct("<iI")
_COUNT = struct.Struct("<I")
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


class TrajectoryCodec:
    """Samples of one loop topic <-> message bytes.

    Parameters
    ----------
    topic : LoopTopic
        Which arrays of a point carry values.
    axes : sequence of str
        Names of the n axes, in order.
    timebase : Timebase
        Sampling clock that gives steps their stamps.
    """

    def __init__(self, topic: LoopTopic, axes: Sequence[str], timebase: Timebase) -> None:
        self.topic = topic
        self.axes = tuple(axes)
        self.timebase = timebase
        self._layouts: dict[int, _Layout] = {}
        self._single = self._layout(1)

    def encode(self, step: int, values: Floats) -> bytes:
        """Make the message of one sample.

        Parameters
        ----------
        step : int
            Step of the sample.
        values : ndarray
            Shape (q, n) for q quantities over n axes, or (n,) where q is 1.

        Raises
        ------
        WireError
            If shape or type do not fit, or a value is not finite.
        """
        return self._encode(self._single, step, values, 1)

    def encode_points(self, step: int, values: Floats) -> bytes:
        """Make the message of a sample and its known future, one point a step.

        Parameters
        ----------
        step : int
            Step of the first point.
        values : ndarray
            Shape (p, q, n), or (p, n) where q is 1.

        Raises
        ------
        WireError
            As `encode`.
        """
        count = len(values) if isinstance(values, np.ndarray) and values.ndim else 1
        if count == 0:
            raise WireError(f"{self.topic.name}: a message needs at least one point")
        return self._encode(self._layout(count), step, values, count)

    def decode(self, raw: bytes) -> tuple[int, Floats]:
        """Read a message.

        Returns
        -------
        step : int
            Step of the first point.
        values : ndarray
            Shape (p, q, n): points, quantities, axes. All finite.

        Raises
        ------
        WireError
            If the bytes are no such message, or not of these axes, quantities and steps.
        """
        layout = self._layout_of(raw)
        if len(raw) < layout.size or raw[:4] != ENCAPSULATION:
            return self._decode_slowly(raw)
        body = np.frombuffer(raw, "<u8", layout.words, 4)
        tail = raw[4 + body.nbytes : layout.size]
        if tail != layout.tail or np.count_nonzero((body & layout.mask) ^ layout.fixed):
            return self._decode_slowly(raw)
        seconds, nanoseconds = _STAMP.unpack_from(raw, 4)
        values = body.view(np.float64)[layout.values]
        if not np.isfinite(values).all():
            raise WireError(f"{self.topic.name}: {_describe_non_finite(values, self)}")
        return self.timebase.step(seconds * NANOSECONDS_PER_SECOND + nanoseconds), values

    def _encode(self, layout: "_Layout", step: int, values: Floats, count: int) -> bytes:
        if not isinstance(values, np.ndarray) or values.dtype != np.float64:
            raise WireError(
                f"{self.topic.name}: values must be a float64 array, not {_type_name(values)}"
            )
        shape = layout.values.shape
        if values.shape != shape:
            single = count == 1 and values.shape == shape[1:]
            flat = shape[1] == 1 and values.shape == (shape[0], shape[2])
            flattest = shape[:2] == (1, 1) and values.shape == (shape[2],)
            if not (single or flat or flattest):
                raise WireError(
                    f"{self.topic.name}: values have shape {values.shape}, not {shape} "
                    f"(points, {'/'.join(self.topic.quantities)}, axes)"
                )
            values = values.reshape(shape)
        if not np.isfinite(values).all():
            raise WireError(f"{self.topic.name}: {_describe_non_finite(values, self)}")
        message = bytearray(layout.template)
        _STAMP.pack_into(
            message, 4, *divmod(step * self.timebase.period_ns, NANOSECONDS_PER_SECOND)
        )
        np.frombuffer(message, "<f8", layout.words, 4)[layout.values] = values
        return bytes(message)

    def _layout(self, count: int) -> "_Layout":
        layout = self._layouts.get(count)
        if layout is None:
            if len(self._layouts) > 64:
                self._layouts.clear()
            layout = _Layout.of(self.topic, self.axes, self.timebase, count)
            self._layouts[count] = layout
        return layout

    def _layout_of(self, raw: bytes) -> "_Layout":
        """Layout for as many points as the message claims, if it claims a sane number."""
        single = self._single
        if len(raw) < single.points_at + 4:
            return single
        (count,) = _COUNT.unpack_from(raw, single.points_at)
        return single if count == 1 or not 1 <= count <= len(raw) // 24 else self._layout(count)

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
        if not np.isfinite(values).all():
            raise WireError(f"{name}: {_describe_non_finite(values, self)}")
        return self.timebase.step(message.stamp_ns), values


@dataclass(frozen=True)
class _Layout:
    """Where things stand in a message of given axes, quantities and number of points."""

    template: bytes
    size: int
    words: int
    tail: bytes  # what stands after the last whole word
    values: npt.NDArray[np.intp]  # (p, q, n) word indices of the doubles
    mask: npt.NDArray[np.uint64]  # ones where a word must be as in the template
    fixed: npt.NDArray[np.uint64]
    points_at: int

    @classmethod
    def of(
        cls, topic: LoopTopic, axes: tuple[str, ...], timebase: Timebase, count: int
    ) -> "_Layout":
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
                if quantity not in topic.quantities:
                    put(struct.pack("<I", 0))
                    continue
                put(struct.pack("<I", len(axes)))
                row = topic.quantities.index(quantity)
                for column in range(len(axes)):
                    at = put(bytes(8), align=8, fixed=False)
                    values[point, row, column] = (at - 4) // 8
            put(_STAMP.pack(*divmod(point * timebase.period_ns, NANOSECONDS_PER_SECOND)))
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


def _describe_non_finite(values: Floats, codec: TrajectoryCodec) -> str:
    point, row, column = np.argwhere(~np.isfinite(values))[0]
    quantity = codec.topic.quantities[row]
    return f"{quantity} of axis {codec.axes[column]} is {values[point, row, column]}"


def _type_name(value: object) -> str:
    dtype = getattr(value, "dtype", None)
    return f"{type(value).__name__} of {dtype}" if dtype is not None else type(value).__name__
