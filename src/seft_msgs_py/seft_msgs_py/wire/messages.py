"""Slow standard messages <-> CDR bytes: text, status, diagnostics, clock, estimates.

The messages are encoded by rosbags' definitions for Jazzy; they are built at first use, which takes
a tenth of a second. Python types are checked here, for the wire and the bags: a value of a wrong
type, and bytes that are no such message, raise a `WireError`.
"""

import json
import math
import struct
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from seft_msgs_py.arrays import Floats
from seft_msgs_py.errors import WireError
from seft_msgs_py.wire import topics
from seft_msgs_py.wire.topics import Timebase, Topic

OK, WARN, ERROR, STALE = range(4)
"""Levels of a DiagnosticStatus."""

_LATEST_NS = 2**31 * topics.NANOSECONDS_PER_SECOND  # seconds are an int32 on the wire
_BYTE_ORDERS = {b"\x00\x01": "deserialize_cdr_le", b"\x00\x00": "deserialize_cdr_be"}
_KEY_VALUE, _TEXTS = "diagnostic_msgs/msg/KeyValue", ("message", "hardware_id")


@dataclass(frozen=True)
class Status:
    """A diagnostic_msgs/msg/DiagnosticStatus of the node ``name``; ``message`` is for people."""

    name: str
    level: int
    message: str
    hardware_id: str = ""
    values: dict[str, str] = field(default_factory=dict)

    def number(self, key: str) -> int | None:
        """Value of a key as a whole number; None if it is none."""
        text = self.values.get(key, "")
        return int(text) if text.isdecimal() and len(text) < 19 else None


@cache
def typestore() -> Typestore:
    """Definitions of the standard messages of ROS 2 Jazzy."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.get_msgdef(topics.JOINT_TRAJECTORY)  # prepared now: a running test may need it first
    return store


def encode_string(text: str) -> bytes:
    """Make a std_msgs/msg/String."""
    return _encode(topics.STRING, _make(topics.STRING, data=_text(text, "String: data")))


def decode_string(raw: bytes) -> str:
    """Read a std_msgs/msg/String."""
    return str(decode_message(topics.STRING, raw).data)


def decode_description(raw: bytes) -> tuple[str, dict[str, Any]]:
    """Read a message of experiment/description: JSON in a String.

    Returns the node's name and the description: ``node``, ``parameters`` (a dict), and more.
    """
    try:
        described = json.loads(decode_string(raw))
    except (ValueError, RecursionError):  # WireError is none of these
        raise WireError(f"{topics.DESCRIPTION.name}: the text is no JSON") from None
    match described:
        case {"node": str(node), "parameters": dict()}:
            return node, described
    raise WireError(f"{topics.DESCRIPTION.name}: the text does not describe a node")


def encode_status(status: Status) -> bytes:
    """Make a diagnostic_msgs/msg/DiagnosticStatus."""
    return _encode(topics.DIAGNOSTIC_STATUS, _status_message(status))


def decode_status(raw: bytes) -> Status:
    """Read a diagnostic_msgs/msg/DiagnosticStatus; of equal keys the last one is used."""
    return _status(decode_message(topics.DIAGNOSTIC_STATUS, raw))


def encode_diagnostics(stamp_ns: int, statuses: Sequence[Status]) -> bytes:
    """Make a diagnostic_msgs/msg/DiagnosticArray with a stamp in nanoseconds."""
    header = _make("std_msgs/msg/Header", stamp=_time(stamp_ns), frame_id="")
    status = [_status_message(each) for each in statuses]
    array = _make(topics.DIAGNOSTIC_ARRAY, header=header, status=status)
    return _encode(topics.DIAGNOSTIC_ARRAY, array)


def restamp(message: bytearray, stamp_ns: int) -> None:
    """Change the stamp at a message's begin; encoding the message takes 100 times longer."""
    struct.pack_into("<iI", message, 4, *divmod(stamp_ns, topics.NANOSECONDS_PER_SECOND))


def decode_diagnostics(raw: bytes) -> tuple[int, list[Status]]:
    """Read a diagnostic_msgs/msg/DiagnosticArray: its stamp in nanoseconds, and the statuses."""
    message = decode_message(topics.DIAGNOSTIC_ARRAY, raw)
    return nanoseconds(message.header.stamp), [_status(item) for item in message.status]


def nodes_named(topic: Topic, raw: bytes) -> set[str]:
    """Names of the nodes that a message of diagnostics or experiment/description tells of."""
    if topic == topics.DESCRIPTION:
        return {decode_description(raw)[0]}
    return {status.name for status in decode_diagnostics(raw)[1]}


def encode_clock(stamp_ns: int) -> bytes:
    """Make a rosgraph_msgs/msg/Clock of a time in nanoseconds."""
    return _encode(topics.CLOCK, _make(topics.CLOCK, clock=_time(stamp_ns)))


def decode_clock(raw: bytes) -> int:
    """Read a rosgraph_msgs/msg/Clock, in nanoseconds."""
    return nanoseconds(decode_message(topics.CLOCK, raw).clock)


def decode_message(type_name: str, raw: bytes, where: str = "") -> Any:
    """Read a message of any standard type; errors name ``where``, by default the type.

    Raises
    ------
    WireError
        If the bytes are no such message. Bytes past the end are ignored.
    """
    where = where or type_name
    if not isinstance(raw, bytes | bytearray | memoryview):
        raise WireError(f"{where}: expected bytes, not {type(raw).__name__}")
    order = _BYTE_ORDERS.get(bytes(raw[:2])) if len(raw) >= 4 else None
    if order is None:
        raise WireError(
            f"{where}: {len(raw)} bytes that start with {bytes(raw[:4]).hex() or 'nothing'} "
            "are no CDR message"
        )
    # not Typestore.deserialize_cdr: it refuses bytes past the end, which middlewares may add
    definition = typestore().get_msgdef(type_name)
    try:
        message, _ = getattr(definition, order)(memoryview(raw)[4:], 0, definition.cls, typestore())
    except (SerdeError, struct.error, ValueError, IndexError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise WireError(f"{where}: the {len(raw)} bytes can't be read: {reason}") from None
    return message


def nanoseconds(time: Any) -> int:
    """Time or duration of a message, in nanoseconds."""
    return int(time.sec) * topics.NANOSECONDS_PER_SECOND + int(time.nanosec)


def _make(type_name: str, **fields: Any) -> Any:
    return typestore().types[type_name](**fields)


def _encode(type_name: str, message: Any) -> bytes:
    return bytes(typestore().serialize_cdr(message, type_name, little_endian=True))


def _status_message(status: Status) -> Any:
    if not isinstance(status, Status):
        raise WireError(f"DiagnosticStatus: expected a Status, not {type(status).__name__}")
    where = f"DiagnosticStatus {_text(status.name, 'DiagnosticStatus: name')}"
    if type(status.level) is not int or not OK <= status.level <= STALE:
        raise WireError(f"{where}: level is {status.level!r}, but must be an int from 0 to 3")
    texts = {name: _text(getattr(status, name), f"{where}: {name}") for name in _TEXTS}
    values = [
        _make(_KEY_VALUE, key=_text(key, f"{where}: a key"), value=_text(value, f"{where}: {key}"))
        for key, value in status.values.items()
    ]
    level, name = status.level, status.name
    return _make(topics.DIAGNOSTIC_STATUS, level=level, name=name, values=values, **texts)


def _status(message: Any) -> Status:
    values = {item.key: item.value for item in message.values}
    return Status(message.name, int(message.level), message.message, message.hardware_id, values)


def _text(value: str, where: str) -> str:
    if not isinstance(value, str):
        raise WireError(f"{where} is {value!r}, but must be text, not {type(value).__name__}")
    if "\x00" in value or value.encode(errors="replace") != value.encode(errors="surrogatepass"):
        raise WireError(f"{where} is {value!r}, which holds characters that no message can carry")
    return value


def _time(stamp_ns: int) -> Any:
    if type(stamp_ns) is not int or not 0 <= stamp_ns < _LATEST_NS:
        need = f"must be an int of nanoseconds from 0 to {_LATEST_NS - 1}"
        raise WireError(f"stamp is {stamp_ns!r}, but {need}")
    seconds, remainder = divmod(stamp_ns, topics.NANOSECONDS_PER_SECOND)
    return _make("builtin_interfaces/msg/Time", sec=seconds, nanosec=remainder)


class EstimatesCodec:
    """Estimates that a compensation method identifies on line over n axes <-> message bytes.

    A diagnostic_msgs/msg/DiagnosticArray with the stamp of the step, and for each axis a status
    ``reference_force: <axis>`` with the estimates by name. Numbers are written by Python's `repr`,
    so that they are read back bit for bit.
    """

    def __init__(self, axes: Sequence[str], timebase: Timebase) -> None:
        self._names = [f"{topics.ESTIMATES.publisher}: {axis}" for axis in axes]
        self._timebase = timebase

    def encode(self, step: int, estimates: Mapping[str, Floats]) -> bytes:
        """Make the message of one step: name -> estimate of each axis, shape (n,), SI units.

        Raises
        ------
        WireError
            If there are none, a shape does not fit the axes, or a value is not finite.
        """
        if not estimates:
            raise WireError(f"{topics.ESTIMATES.name}: a message needs at least one estimate")
        statuses = [Status(name, OK, "identified on line") for name in self._names]
        for name, estimate in estimates.items():
            if np.shape(estimate) != (len(statuses),):
                raise WireError(
                    f"{topics.ESTIMATES.name}: {name} has shape {np.shape(estimate)}, "
                    f"not ({len(statuses)},) (axes)"
                )
            for status, value in zip(statuses, estimate, strict=True):
                status.values[name] = text = repr(float(value))
                _number(text, name, status.name)
        return encode_diagnostics(self._timebase.stamp_ns(step), statuses)

    def decode(self, raw: bytes) -> tuple[int, dict[str, Floats]]:
        """Read a message: its step, and at least one estimate, as `encode` takes them.

        Raises
        ------
        WireError
            If the bytes are no such message, or not of these axes and steps.
        """
        stamp_ns, statuses = decode_diagnostics(raw)
        found = [status.name for status in statuses]
        if found != self._names:
            raise WireError(f"{topics.ESTIMATES.name}: statuses are {found}, not {self._names}")
        names = list(statuses[0].values)
        if not names or any(list(status.values) != names for status in statuses):
            raise WireError(f"{topics.ESTIMATES.name}: axes need the same estimates, at least one")
        rows = {name: [_number(s.values[name], name, s.name) for s in statuses] for name in names}
        return self._timebase.step(stamp_ns), {name: np.array(row) for name, row in rows.items()}


def _number(text: str, name: str, status: str) -> float:
    with suppress(ValueError):
        if math.isfinite(number := float(text)):
            return number
    need = "must be a finite number"
    raise WireError(f"{topics.ESTIMATES.name}: {name} of {status} is {text}, but {need}")
