"""Start and end of a ROS process: settings of FastDDS, shared memory, a unique name.

`network.xml` and `one_host.xml` contain the settings:

- UDP only, also on one host. Shared memory is not faster here (`bench/loop.py` measures both). Its
  ports are shared by all tests on a host, in any domain. FastDDS takes a port without activity for
  one second for dead: while other tests start, end or are killed, or while the host stalls, a
  running node may lose its port and receive nothing after that. Killed processes leave files.
- A participant announces itself for 3 s, not for half a second: if six start together, some miss
  each other, and would only find each other at the next announcement, 3 s later.
- Readers acknowledge samples at a heartbeat; with the default period of 3 s thousands of samples
  accumulate, and removing them stops a publisher for milliseconds.
- While nacks of the last sample are suppressed, the next one does not wake the event thread.
- FastDDS writes its messages to stderr: stdout is for results.
"""

import ctypes
import errno
import os
import signal
import socket
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

from seft_msgs_py.errors import InputError

NETWORK = Path(__file__).with_name("network.xml")
ONE_HOST = Path(__file__).with_name("one_host.xml")
PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
FOLDER = Path("/dev/shm")
TRACERS = "lttng-ust-wait-*"
_HIGHEST_DOMAIN = 232  # beyond it UDP has no ports for a domain
_RANGES = ("SUBNET", "LOCALHOST", "SYSTEM_DEFAULT")
_FLAGS = (
    *("RCUTILS_COLORIZED_OUTPUT", "RCUTILS_LOGGING_USE_STDOUT"),
    *("RCUTILS_LOGGING_BUFFERED_STREAM", "ROS_LOCALHOST_ONLY"),
)


def check_environment() -> None:
    """Check the variables with which ROS can't work: C++ ends the process, or nodes never meet.

    Raises
    ------
    InputError
        That names the variable.
    """
    rules: dict[str, tuple[Callable[[str], bool], str]] = {
        "ROS_DOMAIN_ID": (
            lambda text: text.isascii() and text.isdecimal() and int(text) <= _HIGHEST_DOMAIN,
            f"a whole number, 0 to {_HIGHEST_DOMAIN}",
        ),
        "RMW_IMPLEMENTATION": (_has_library, "rmw_fastrtps_cpp, or another that is installed"),
        RANGE: (_RANGES.__contains__, f"{', '.join(_RANGES)}: with OFF no node finds another"),
        PROFILES: (os.path.isfile, "the name of a file"),
        **dict.fromkeys(_FLAGS, (("0", "1").__contains__, "0 or 1")),
    }
    for name, (is_right, what) in rules.items():
        text = os.environ.get(name, "")
        if text and not is_right(text):
            raise InputError(f"{name} is {text}, but must be {what}; set it so, or unset it")


def _has_library(middleware: str) -> bool:
    """Whether rcl finds a middleware."""
    folders = [*os.environ.get("LD_LIBRARY_PATH", "").split(":"), f"{sys.prefix}/lib"]
    found = (Path(folder, f"lib{middleware}.so").is_file() for folder in folders)
    return middleware == "rmw_fastrtps_cpp" or (middleware.startswith("rmw_") and any(found))


def prepare_middleware() -> None:
    """Make FastDDS read our settings, unless the environment names others, or static peers.

    Call this before rclpy starts; processes that are started later inherit the settings.
    """
    named = os.environ.get(PROFILES)
    if named not in (None, str(NETWORK), str(ONE_HOST)):
        return
    if os.environ.get(RANGE) == "LOCALHOST":
        if not os.environ.get("ROS_STATIC_PEERS"):  # only rmw's own settings use it
            os.environ[PROFILES] = str(ONE_HOST)
            os.environ[RANGE] = "SYSTEM_DEFAULT"  # at LOCALHOST rmw adds shared memory
    elif named is None:
        os.environ[PROFILES] = str(NETWORK)


def prepare_on_this_host() -> None:
    """Do the same, and stay on this host unless the environment sets another range."""
    os.environ.setdefault(RANGE, "LOCALHOST")
    prepare_middleware()


def check_shared_memory(folder: Path = FOLDER) -> None:
    """Check that there is a page of shared memory for rclpy's tracer (LTTng).

    The tracer maps a file there when rclpy is imported; without memory for that file the kernel
    ends the process (SIGBUS). Our messages do not need shared memory.

    Raises
    ------
    InputError
        If there is none.
    """
    files = list(folder.glob(TRACERS))
    if (files and all(file.stat().st_blocks for file in files)) or not folder.is_dir():
        return
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            os.posix_fallocate(file.fileno(), 0, 2 * os.sysconf("SC_PAGESIZE"))
    except OSError as error:
        if error.errno == errno.ENOSPC:
            why = "and no ROS process can start: remove unused files there"
            raise InputError(f"{folder} is full, {why}") from None


def single_instance(domain: int, node: str) -> socket.socket:
    """Hold the full name of a node on this host in a ROS domain, until the socket is closed.

    Two tests on one ROS domain would command each other's rig, because DDS discovery of the other's
    names may take seconds. The socket is in Linux's abstract namespace: the kernel frees it at any
    end of the process, and like the ROS domain it belongs to the network namespace.

    Raises
    ------
    InputError
        If another process has the name.
    """
    held = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        held.bind(f"\0seft/{domain}{node}")
    except OSError:
        held.close()
        raise InputError(
            f"ROS domain {domain} already has a node {node} on this host (another test); end "
            "it, or set ROS_DOMAIN_ID to another number"
        ) from None
    return held


def is_running(domain: int, node: str) -> bool:
    """Say whether a process of this host holds the full name of a node."""
    try:
        single_instance(domain, node).close()
    except InputError:
        return True
    return False


_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_OUTPUTS = (1, 2)
_Handler = Callable[[int, FrameType | None], None]


def on_ending(handler: _Handler) -> dict[signal.Signals, Any]:
    """Call ``handler`` when a signal requests this process to end; return the old handlers.

    SIGHUP means that the terminal has been closed: output, which would fail, is then discarded. If
    SIGHUP is ignored (`nohup`), it stays ignored.
    """
    terminals = [file for file in _OUTPUTS if os.isatty(file)]

    def on_signal(number: int, frame: FrameType | None) -> None:
        if number == signal.SIGHUP:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            for file in terminals:
                os.dup2(nowhere, file)
            os.close(nowhere)
        handler(number, frame)

    before = {number: signal.getsignal(number) for number in _SIGNALS}
    for number in _SIGNALS:
        if number != signal.SIGHUP or before[number] is not signal.SIG_IGN:
            signal.signal(number, on_signal)
    return before


def as_before(handlers: dict[signal.Signals, Any]) -> None:
    """Restore the handlers that `on_ending` has returned."""
    for number, handler in handlers.items():
        signal.signal(number, handler)


_CHandler = ctypes.CFUNCTYPE(None, ctypes.c_int)


@contextmanager
def exit_watchdog(seconds: float, status: int, message: str = "") -> Iterator[None]:
    """End the process with a status if the context takes longer.

    FastDDS 2.14 can deadlock when a participant is destroyed at the moment when another one leaves
    (``DomainParticipant::set_listener``), and keeps Python's lock while it waits. So the handler is
    a C function, which does not need the lock. Only the message of leaving is lost: others see the
    node until its lease expires.

    Parameters
    ----------
    seconds : float
        Patience.
    status : int
        Exit status.
    message : str
        Written to stderr then.
    """

    def end(_: int) -> None:
        if message:
            os.write(2, f"{message}\n".encode())
        os._exit(status)

    handler = _CHandler(end)
    libc = ctypes.CDLL(None)
    libc.signal.restype = ctypes.c_void_p
    libc.signal.argtypes = [ctypes.c_int, ctypes.c_void_p]
    before = libc.signal(signal.SIGALRM, ctypes.cast(handler, ctypes.c_void_p))
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        libc.signal(signal.SIGALRM, before)
