"""The state of a test with its values, as the supervisor publishes it: written and read."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any, NamedTuple

from seft_msgs_py.errors import InputError, WireError
from seft_msgs_py.wire.messages import ERROR, OK, WARN, Status, decode_status, encode_status
from seft_msgs_py.wire.outcome import State
from seft_msgs_py.wire.topics import EXPERIMENT_STATE

EXPERIMENT = "experiment"
"""Name in the supervisor's status of a test."""
MAX_START_DELAY_S = 5.0  # s
_LEVELS = {State.RAMPING_DOWN: WARN, State.TRIPPED: ERROR}


@dataclass(frozen=True)
class ExperimentState:
    """A message of experiment/state.

    The fields after ``state`` are its values: their names are the keys, and their types say how
    they are written. A message leaves out what is as by default.

    Attributes
    ----------
    state : State
        Where the test is.
    detail : str
        Why: what the test waits for, or how it ended.
    steps : int or None
        Of the test, once they are known.
    step : int or None
        Of a trip.
    time_s : float or None
        Experiment time of that step, s.
    pace : str
        The rig's, as it reports it; empty if unknown.
    silent : tuple of str or None
        Nodes that had fallen silent before a trip, once that is known; may be empty.
    start_ns : int or None
        Common start of several rigs, ns of the wall clock.
    rehearse : float
        Duration of a requested rehearsal of the loop, s; 0: none.
    zeroing : float
        Time at rest in it, in which the rig measures its biases, s.
    """

    state: State
    detail: str = ""
    steps: int | None = None
    step: int | None = None
    time_s: float | None = None
    pace: str = ""
    silent: tuple[str, ...] | None = None
    start_ns: int | None = None
    rehearse: float = 0.0
    zeroing: float = 0.0

    @property
    def level(self) -> int:
        """Level of its status."""
        return _LEVELS.get(self.state, OK)

    def until_start(self, now_ns: int) -> float:
        """Time from now, ns of the wall clock, to the common start of several rigs, s.

        It is negative if that moment has passed, and 0 if the test has one rig.

        Raises
        ------
        InputError
            If it is far away: the clocks of the hosts differ.
        """
        if self.start_ns is None:
            return 0.0
        ahead = (self.start_ns - now_ns) / 1e9
        if abs(ahead) > MAX_START_DELAY_S:
            raise InputError(
                f"the common start of the rigs is {ahead:.3g} s from now by this host's clock: set "
                "the clocks of all hosts by one (PTP, or NTP)"
            )
        return ahead


def _whole(text: str) -> int:
    if not (text.isascii() and text.isdecimal() and int(text) < 2**63):
        raise ValueError
    return int(text)


def _seconds(text: str) -> float:
    if not 0.0 <= (number := float(text)) < float("inf"):
        raise ValueError
    return number


class _Kind(NamedTuple):
    """How the values of a type are written and read, and what they must be."""

    write: Callable[[Any], str]
    read: Callable[[str], Any]
    what: str


_TEXT = _Kind(lambda text: text, str, "text")
_WHOLE = _Kind(str, _whole, "a whole number from 0 to 2^63 - 1")
_SECONDS = _Kind(lambda number: repr(float(number)), _seconds, "a finite time, not negative, in s")
_NAMES = _Kind(" ".join, lambda text: tuple(text.split()), "names of nodes without spaces")
_BY_TYPE: dict[Any, _Kind] = {
    str: _TEXT,
    int | None: _WHOLE,
    float: _SECONDS,
    float | None: _SECONDS,
    tuple[str, ...] | None: _NAMES,
}
_VALUES = {one.name: (_BY_TYPE[one.type], one.default) for one in fields(ExperimentState)[1:]}


def encode_state(state: ExperimentState) -> bytes:
    """Make a message of experiment/state, of which `decode_state` reads the same.

    Raises
    ------
    WireError
        If a value can't be written.
    """
    texts = {}
    for key, (kind, default) in _VALUES.items():
        if (value := getattr(state, key)) == default:
            continue
        try:
            texts[key] = kind.write(value)
            if kind.read(texts[key]) != value:
                raise ValueError
        except (TypeError, ValueError, OverflowError):
            raise _refused(key, value, kind.what) from None
    return encode_status(Status(EXPERIMENT, state.level, str(state.state), values=texts))


def decode_state(raw: bytes) -> ExperimentState:
    """Read a message of experiment/state; unknown keys are ignored.

    Heartbeats repeat a message, which is decoded once.

    Raises
    ------
    WireError
        If the bytes are no such message, or a value is not of its type.
    """
    return _known_state(raw) if isinstance(raw, bytes) else _read_state(raw)


def _read_state(raw: bytes) -> ExperimentState:
    status = decode_status(raw)
    if status.message not in State:
        raise _refused("state", status.message, f"one of {', '.join(State)}")
    found = {}
    for key, (kind, _) in _VALUES.items():
        if (text := status.values.get(key)) is None:
            continue
        try:
            found[key] = kind.read(text)
        except ValueError:
            raise _refused(key, text, kind.what) from None
    return ExperimentState(State(status.message), **found)


_known_state = lru_cache(maxsize=16)(_read_state)


def _refused(key: str, value: Any, what: str) -> WireError:
    return WireError(f"{EXPERIMENT_STATE.name}: {key} is {value!r}, but must be {what}")
