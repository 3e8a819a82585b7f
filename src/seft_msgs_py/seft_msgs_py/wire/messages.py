"""Slow standard messages <-> CDR bytes: text, status, diagnostics, clock.

rosbags' description of the Jazzy messages does the work; it is built at the first use, which
takes a tenth of a second. Python types are checked here, for the wire and the bags alike.
"""

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache, lru_cache
from typing import Any

from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.timebase import NANOSECONDS_PER_SECOND
from seft_msgs_py.wire.topics import CLOCK, DESCRIPTION, DIAGNOSTIC_ARRAY, DIAGNOSTIC_STATUS, STRING

OK, WARN, ERROR, STALE = range(4)
"""Levels of a DiagnosticStatus."""

_LATEST_NS = 2**31 * NANOSECONDS_PER_SECOND  # seconds are an int32 on the wire
_BYTE_ORDERS = {b"\x00\x01": "deserialize_cdr_le", b"\x00\x00": "deserialize_cdr_be"}


@dataclass(frozen=True)
class Status:
    """A diagnostic_msgs/msg/DiagnosticStatus.

    Attributes
    ----------
    name : str
        Whose state it is: the node's name.
    level : int
        `OK`, `WARN`, `ERROR` or `STALE`.
    message : str
        One line for people.
    hardware_id : str
        The hardware it is about; may be empty.
    values : dict of str to str
        Key -> value.
    """

    name: str
    level: int
    message: str
    hardware_id: str = ""
    values: dict[str, str] = field(default_factory=dict)


@cache
def typestore() -> Typestore:
    """Definitions of the standard messages of ROS 2 Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


def encode_string(text: str) -> bytes:
    """Make a std_msgs/msg/String; WireError if it is no text that the wire can carry."""
    return _encode(STRING, data=_text(text, "String: data"))


def decode_string(raw: bytes) -> str:
    """Read a std_msgs/msg/String; WireError if the bytes are none."""
    return str(_decode(STRING, raw).data)


def encode_status(status: Status) -> bytes:
    """Make a diagnostic_msgs/msg/DiagnosticStatus.

    Raises
    ------
    WireError
        If a field has the wrong type, or the level is none of the four.
    """
    return _serialise(DIAGNOSTIC_STATUS, _status_message(status))


def decode_status(raw: bytes) -> Status:
    """Read a diagnostic_msgs/msg/DiagnosticStatus; of keys that come twice the last counts.

    A sign of life repeats a message, which is read once; nobody may change what is given.

    Raises
    ------
    WireError
        If the bytes are no such message.
    """
    return _known_status(raw) if isinstance(raw, bytes) else _read_status(raw)


def _read_status(raw: bytes) -> Status:
    return _status(_decode(DIAGNOSTIC_STATUS, raw))


_known_status = lru_cache(maxsize=16)(_read_status)


def encode_diagnostics(stamp_ns: int, statuses: Sequence[Status]) -> bytes:
    """Make a diagnostic_msgs/msg/DiagnosticArray.

    Parameters
    ----------
    stamp_ns : int
        Time of the message, in nanoseconds.
    statuses : sequence of Status
        What it tells.

    Raises
    ------
    WireError
        As `encode_status`, or if the stamp does not fit the wire.
    """
    header = _make("std_msgs/msg/Header", stamp=_time(stamp_ns), frame_id="")
    return _encode(DIAGNOSTIC_ARRAY, header=header, status=[_status_message(s) for s in statuses])


def restamp(message: bytearray, stamp_ns: int) -> None:
    """Give a message that begins with a time another one; encoding anew costs 100 times as much."""
    struct.pack_into("<iI", message, 4, *divmod(stamp_ns, NANOSECONDS_PER_SECOND))


def decode_diagnostics(raw: bytes) -> tuple[int, list[Status]]:
    """Read a diagnostic_msgs/msg/DiagnosticArray.

    Returns
    -------
    stamp_ns : int
        Time of the message, in nanoseconds.
    statuses : list of Status
        What it tells.

    Raises
    ------
    WireError
        If the bytes are no such message.
    """
    message = _decode(DIAGNOSTIC_ARRAY, raw)
    return _nanoseconds(message.header.stamp), [_status(item) for item in message.status]


def encode_clock(stamp_ns: int) -> bytes:
    """Make a rosgraph_msgs/msg/Clock of a time in nanoseconds; WireError if it does not fit."""
    return _encode(CLOCK, clock=_time(stamp_ns))


def decode_clock(raw: bytes) -> int:
    """Read a rosgraph_msgs/msg/Clock, in nanoseconds; WireError if the bytes are none."""
    return _nanoseconds(_decode(CLOCK, raw).clock)


def _make(type_name: str, **fields: Any) -> Any:
    return typestore().types[type_name](**fields)


def _encode(type_name: str, **fields: Any) -> bytes:
    return _serialise(type_name, _make(type_name, **fields))


def _serialise(type_name: str, message: Any) -> bytes:
    return bytes(typestore().serialize_cdr(message, type_name, little_endian=True))


def _decode(type_name: str, raw: bytes) -> Any:
    if not isinstance(raw, bytes | bytearray | memoryview):
        raise WireError(f"{type_name}: expected bytes, not {type(raw).__name__}")
    order = _BYTE_ORDERS.get(bytes(raw[:2])) if len(raw) >= 4 else None
    if order is None:
        raise WireError(
            f"{type_name}: {len(raw)} bytes that start with {bytes(raw[:4]).hex() or 'nothing'} "
            "are no CDR message"
        )
    # not Typestore.deserialize_cdr: it refuses bytes past the end, which middlewares may add
    definition = typestore().get_msgdef(type_name)
    try:
        message, _ = getattr(definition, order)(memoryview(raw)[4:], 0, definition.cls, typestore())
    except (SerdeError, struct.error, ValueError, IndexError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise WireError(f"{type_name}: the {len(raw)} bytes can't be read: {reason}") from None
    return message


def _status_message(status: Status) -> Any:
    if not isinstance(status, Status):
        raise WireError(f"DiagnosticStatus: expected a Status, not {type(status).__name__}")
    name = _text(status.name, "DiagnosticStatus: name")
    if type(status.level) is not int or not OK <= status.level <= STALE:
        raise WireError(
            f"DiagnosticStatus {name}: level is {status.level!r}, but must be an int from 0 to 3"
        )
    return _make(
        DIAGNOSTIC_STATUS,
        level=status.level,
        name=name,
        message=_text(status.message, f"DiagnosticStatus {name}: message"),
        hardware_id=_text(status.hardware_id, f"DiagnosticStatus {name}: hardware_id"),
        values=[
            _make(
                "diagnostic_msgs/msg/KeyValue",
                key=_text(key, f"DiagnosticStatus {name}: a key"),
                value=_text(value, f"DiagnosticStatus {name}: {key}"),
            )
            for key, value in status.values.items()
        ],
    )


def _status(message: Any) -> Status:
    return Status(
        name=message.name,
        level=int(message.level),
        message=message.message,
        hardware_id=message.hardware_id,
        values={item.key: item.value for item in message.values},
    )


def _text(value: str, where: str) -> str:
    if not isinstance(value, str):
        raise WireError(f"{where} is {value!r}, but must be text, not {type(value).__name__}")
    if "\x00" in value or value.encode(errors="replace") != value.encode(errors="surrogatepass"):
        raise WireError(f"{where} is {value!r}, which holds characters that no message can carry")
    return value


def _time(stamp_ns: int) -> Any:
    if type(stamp_ns) is not int or not 0 <= stamp_ns < _LATEST_NS:
        raise WireError(
            f"stamp is {stamp_ns!r}, but must be an int of nanoseconds from 0 to {_LATEST_NS - 1}"
        )
    seconds, nanoseconds = divmod(stamp_ns, NANOSECONDS_PER_SECOND)
    return _make("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)


def _nanoseconds(time: Any) -> int:
    return int(time.sec) * NANOSECONDS_PER_SECOND + int(time.nanosec)


def decode_description(raw: bytes) -> tuple[str, dict[str, Any]]:
    """Read a message of experiment/description.

    Returns
    -------
    node : str
        Who tells.
    description : dict
        ``node``, ``parameters`` (dict), and what else it tells.

    Raises
    ------
    WireError
        If it is no description of a node.
    """
    try:
        described = json.loads(decode_string(raw))
    except (ValueError, RecursionError):  # WireError is none of these
        raise WireError(f"{DESCRIPTION.name}: the text is no JSON") from None
    match described:
        case {"node": str(node), "parameters": dict()}:
            return node, described
    raise WireError(f"{DESCRIPTION.name}: the text does not describe a node")
