"""A laboratory's controller at the other end of UDP datagrams.

docs/udp.md has their layout, and what either side obeys. The side that is the clock numbers its
datagrams; the other answers each by its number. All else is counted.
"""

import socket
import struct
import time
import zlib
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.facts import POSITION_SERVO
from seft_msgs_py.config.parameter_table import parameter_rows, per_axis
from seft_msgs_py.errors import InputError

UDP_ROWS = parameter_rows(
    """
    address | string | 127.0.0.1:5005 |   |                  | host:port of the controller
    port    | int    | 5006           |   | 1 .. 65535       |
        port of this host to which the controller sends
    clock   | string | controller     |   | controller, host |
        controller: it sends samples at its own rate, and this host follows; host: it answers each
        command with a sample
    timeout | float  | 0.02           | s | > 0              |
        longest silence of the controller; the controller has its own for the host
    """,
    "udp",
)
UDP_COUNTS = ("late", "lost", "repeated", "reordered", "corrupted", "foreign", "truncated")

_SAMPLE, _COMMAND = b"SEFS", b"SEFC"
_VERSION = 1
_HEADER = struct.Struct("<4sHHII")  # magic, version, axes, step, and state or mode
_TIME = struct.Struct("<d")
_CRC = struct.Struct("<I")
_CLOSED, _RUN = 0, 1
_STEPS = 2**32
_WINDOW = 32  # newest steps of which is remembered whether they came
_FARTHEST = 1000  # lost samples in a row that read() stands in for
_LONGEST = 4096  # bytes of a datagram
_RATE_ERROR = 0.05  # of the rate


class UdpHardware:
    """Controller of a rig of n axes.

    With the controller's clock, send the answer to a sample by `write` before the controller takes
    its next one. While the valve is closed, `read` sends the safe command, at once, so that the
    controller hears this host at rest, too; the valve opens by the answer to a later sample.

    Parameters
    ----------
    parameters : mapping
        Of the section ``rig``: ``udp.*``, ``rate``, ``pace`` and ``safe.valve_command``.
    axes : tuple of str
        The n axes.

    Attributes
    ----------
    is_clock : bool
        Whether the controller is the clock.
    can_wait : bool
        Whether `read` gives the sample after the last `write`: the host is the clock.
    counts : dict
        Number of datagrams by `UDP_COUNTS`.
    """

    can_wait = False
    is_clock = False

    def __init__(self, parameters: Mapping[str, Any], axes: tuple[str, ...]) -> None:
        self.is_clock = parameters["udp.clock"] == "controller"
        self.can_wait = not self.is_clock
        self.counts = dict.fromkeys(UDP_COUNTS, 0)
        self._axes, self._rate = axes, float(parameters["rate"])
        self._timeout = float(parameters["udp.timeout"])
        self._wait = self._timeout
        if self.can_wait and parameters["pace"] != "lockstep":
            self._wait = min(self._timeout, 1.0 / self._rate)  # an answer comes within a period
        self._safe = per_axis(parameters["safe.valve_command"], axes, "rig: safe.valve_command")
        self._holds = parameters.get("actuator.kind") == POSITION_SERVO
        self._mode, self._drive = _CLOSED, self._safe
        self._sent = 0  # step of the newest command, if this host is the clock
        self._note = ""  # on the last datagram that was refused
        self._has_failed = False  # since the last `safe`
        self._spoke = time.monotonic()  # s, of the newest command
        self._socket, self._peer = _open(parameters["udp.address"], parameters["udp.port"])
        self._begin_anew()

    def _begin_anew(self) -> None:
        """Forget the steps so far, because either side may have been started again."""
        self._newest: int | None = None  # step of the last sample that was obeyed
        self._seen = 0  # bit i: whether step newest - i came
        self._waiting: deque[tuple[int, Floats]] = deque()  # samples that were not read yet
        self._step: int | None = None  # of the sample that was read last
        self._said: tuple[int, int] | None = None  # step and mode of the newest command
        self._is_due = True  # since the last sample was read, no command was sent
        self._heard = time.monotonic()  # s, of the last sample
        self._unanswered = 0.0  # s for which commands in a row found no answer
        self._is_open, self._fault = False, ""
        self._rated: tuple[int, float] | None = None  # step and time from which the rate counts

    def read(self) -> Floats:
        """Wait for the next sample, shape (4, n); NaN where one was lost.

        Raises
        ------
        OSError
            If the controller is silent, has closed its valve by itself, or samples at another rate.
            The valve is then closed, as by `safe`.
        """
        if self.can_wait and self._is_due and self._mode == _CLOSED:
            self._send(None)
        follows = self.is_clock and self._mode == _RUN
        end = self._heard + self._timeout if follows else time.monotonic() + self._wait
        while not self._waiting and (left := end - time.monotonic()) > 0:
            self._receive(left)
        if self.is_clock and self._mode == _CLOSED:
            self._receive_all()  # at rest, the newest counts
            while len(self._waiting) > 1:
                self._waiting.popleft()
        if self._fault:
            raise self._failure(ConnectionError, self._fault)
        if follows and self._heard + self._timeout < time.monotonic():
            self._waiting.clear()  # they came while this host stood still
        self._is_due = True
        if not self._waiting:
            return self._silence()
        self._unanswered = 0.0
        self._step, sample = self._waiting.popleft()
        if self.is_clock and self._mode == _CLOSED:
            self._send(self._step)
        return sample

    def missing(self) -> str:
        """Say that samples of the controller did not come, where a test ends without numbers."""
        return self._described("samples of the controller are missing or late; is it running?")

    def write(self, drive: Floats) -> None:
        """Send valve commands, V, shape (n,); the controller opens its valve.

        After a fault the valve remains closed until `safe`: nobody knows where it was meanwhile.
        """
        if self._has_failed:
            return
        if self._mode == _CLOSED:
            self._is_open = False
            if self.is_clock:
                self._receive_all()
                self._waiting.clear()  # a test goes on with the sample after its first command
                self._send(self._newest)  # before mode 1, however long this host was silent
            elif self._spoke + self._timeout < time.monotonic():
                self.read()  # likewise
            self._heard = time.monotonic()
            self._opened = self._heard + 1.0 / self._rate
        self._mode, self._drive = _RUN, drive
        self._send(self._step)

    def safe(self) -> None:
        """Tell the controller to close its valve."""
        self._mode, self._has_failed = _CLOSED, False
        if not self._holds:  # a displacement servo keeps its last command
            self._drive = self._safe
        if self.is_clock:
            self._receive_all()  # it obeys the answer to its newest sample
        self._send(self._newest)

    def close(self) -> None:
        """Give the port back; the controller hears nothing more, and keeps its valve closed."""
        self._socket.close()

    def _silence(self) -> Floats:
        """Stand in for a sample that did not come; fail after udp.timeout."""
        self._unanswered += self._wait
        if self._unanswered < self._timeout:
            return self._lost_sample()
        where, port = "{}:{}".format(*self._peer), self._socket.getsockname()[1]
        raise self._failure(
            TimeoutError,
            f"no sample from the controller at {where} within udp.timeout ({self._timeout:g} s); "
            f"is it running, and does it send to port {port} of this host?",
        )

    def _send(self, step: int | None) -> None:
        """Send the drive: the answer to a step, or, by this host's clock, a new one."""
        if self.can_wait:
            step = self._sent = (self._sent + 1) % _STEPS
        self._is_due = False
        if step is None:
            return
        last, mode = self._said or (step - 1, _CLOSED)
        if (self._mode == _RUN or mode == _CLOSED) and _ahead(step, last) <= 0:
            return  # this sample, or a newer one, has been answered
        self._said, self._spoke = (step, self._mode), time.monotonic()
        raw = _HEADER.pack(_COMMAND, _VERSION, len(self._axes), step, self._mode)
        raw += np.asarray(self._drive, dtype="<f8").tobytes()
        try:
            self._socket.sendto(raw + _CRC.pack(zlib.crc32(raw)), self._peer)
        except OSError as error:  # the link is down: silence will say so
            self._note = str(error)

    def _receive(self, wait: float) -> bool:
        """Obey or count the next datagram; False if none comes."""
        self._socket.settimeout(wait)
        try:
            raw, sender = self._socket.recvfrom(_LONGEST)
        except (TimeoutError, BlockingIOError):
            return False
        kind = self._obey(raw) if sender == self._peer else "foreign"
        if kind:
            self.counts[kind] += 1
        if sender != self._peer:
            self._note = "it came from {}:{}".format(*sender)
        return True

    def _receive_all(self) -> None:
        """Receive what has come, but no longer than a moment."""
        for _ in range(_FARTHEST):
            if not self._receive(0.0):
                break

    def _obey(self, raw: bytes) -> str:
        """Take the sample of a datagram; say as what it counts otherwise."""
        n, end = len(self._axes), len(raw) - _CRC.size
        size = _HEADER.size + _TIME.size + 32 * n
        is_whole = end >= _HEADER.size and _CRC.unpack_from(raw, end)[0] == zlib.crc32(raw[:end])
        if not is_whole:
            return "truncated" if end != size else "corrupted"
        magic, version, axes, step, state = _HEADER.unpack_from(raw)
        if magic != _SAMPLE or version != _VERSION or axes != n:
            self._note = f"it sent {magic!r} of version {version} with {axes} axes, not {n}"
            return "foreign"
        if end != size or state not in (_CLOSED, _RUN):
            return "truncated" if end != size else "corrupted"
        if kind := self._out_of_order(step):
            return kind
        values = np.frombuffer(raw, "<f8", 4 * n, _HEADER.size + _TIME.size)
        self._waiting.append((step, values.reshape(4, n).astype(np.float64)))
        self._heard = time.monotonic()
        self._follow_state(state)
        self._follow_rate(step, _TIME.unpack_from(raw, _HEADER.size)[0])
        return ""

    def _out_of_order(self, step: int) -> str:
        """Take the step of a sample; say as what it counts if it is not the next one."""
        if self.can_wait and _ahead(step, self._sent) > 0:
            return "foreign"  # answers nothing of this host
        ahead = 1 if self._newest is None else _ahead(step, self._newest)
        if ahead <= 0:
            is_known = -ahead < _WINDOW and self._seen >> -ahead & 1
            return "repeated" if is_known else "reordered" if ahead == -1 else "late"
        if self.can_wait and step != self._sent:
            return "late"
        self.counts["lost"] += ahead - 1
        if self.is_clock and self._mode == _RUN:
            lost = range(1, min(ahead, _FARTHEST))
            self._waiting.extend(((step - ahead + i) % _STEPS, self._lost_sample()) for i in lost)
        self._newest, self._seen = step, (self._seen << min(ahead, _WINDOW) | 1) % 2**_WINDOW
        return ""

    def _lost_sample(self) -> Floats:
        return np.full((4, len(self._axes)), np.nan)

    def _follow_state(self, state: int) -> None:
        """In a test, see whether the controller's valve opens, and remains open."""
        if self._mode == _CLOSED:
            return
        if state == _RUN:
            self._is_open = True
        elif self._is_open:
            self._fault = "the controller has closed its valve by itself; see what it reports"
        elif self.can_wait or self._heard - self._opened > self._timeout:
            self._fault = "the controller does not open its valve; see what it reports"

    def _follow_rate(self, step: int, at: float) -> None:
        """See about once a second whether a controller that is the clock has the test's rate."""
        if self._rated is None:
            self._rated = step, at
        steps, seconds = _ahead(step, self._rated[0]), at - self._rated[1]
        if self.can_wait or steps < self._rate:
            return
        self._rated = step, at
        if not abs(seconds * self._rate / steps - 1.0) <= _RATE_ERROR:
            self._fault = (
                f"the controller's time (s) goes on by {seconds:.4g} in {steps} steps, but the "
                f"test's rate is {self._rate:g} Hz; make them agree"
            )

    def _failure(self, kind: type[OSError], text: str) -> OSError:
        """Close the valve, and give the error to raise."""
        self.safe()
        self._begin_anew()
        self._has_failed = True
        return kind(self._described(text))

    def _described(self, text: str) -> str:
        note = f"; the last that was refused: {self._note}" if self._note else ""
        counted = ", ".join(f"{count} {name}" for name, count in self.counts.items() if count)
        return f"rig: udp: {text}{note}" + (f"; so far {counted}" if counted else "")


def _ahead(step: int, other: int) -> int:
    """Count the steps by which one is ahead of another; after 2^32 - 1 they go on at 0."""
    return (step - other + _STEPS // 2) % _STEPS - _STEPS // 2


def _open(address: str, port: int) -> tuple[socket.socket, tuple[str, int]]:
    """Open a port of the interface that leads to a controller; InputError if it can't be."""
    host, _, number = address.rpartition(":")
    own = socket.socket(type=socket.SOCK_DGRAM)
    try:
        peer = socket.gethostbyname(host), int(number)
        if not 0 < peer[1] < 65536:
            raise ValueError(f"{number} is no port")
        with socket.socket(type=socket.SOCK_DGRAM) as probe:
            probe.connect(peer)
            interface = probe.getsockname()[0]
        own.bind((interface, port))
    except (OSError, ValueError) as error:
        own.close()
        raise InputError(
            f"rig: udp.address is {address}, udp.port {port}, but {error}; the address must be "
            "host:port of the controller, and the port one of this host that is free"
        ) from None
    return own, peer
