"""The end of a process: Ctrl-C, SIGTERM or a closed terminal ask for it, and it does not hang."""

import ctypes
import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rclpy.node import Node

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_OUTPUTS = (1, 2)
Handler = Callable[[int, FrameType | None], None]


def on_ending(handler: Handler) -> dict[signal.Signals, Any]:
    """Have ``handler`` called when a signal asks this process to end; return the old handlers.

    SIGHUP means that the terminal has been closed: output, which would fail, is then discarded. It
    stays ignored where it is (`nohup`).
    """
    terminals = [file for file in _OUTPUTS if os.isatty(file)]

    def on_signal(number: int, frame: FrameType | None) -> None:
        if number == signal.SIGHUP:
            _write_nowhere(terminals)
        handler(number, frame)

    before = {number: signal.getsignal(number) for number in SIGNALS}
    for number in SIGNALS:
        if number != signal.SIGHUP or before[number] is not signal.SIG_IGN:
            signal.signal(number, on_signal)
    return before


def as_before(handlers: dict[signal.Signals, Any]) -> None:
    """Restore the handlers that `on_ending` has returned."""
    for number, handler in handlers.items():
        signal.signal(number, handler)


def _write_nowhere(files: list[int]) -> None:
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for file in files:
        os.dup2(nowhere, file)
    os.close(nowhere)


_Handler = ctypes.CFUNCTYPE(None, ctypes.c_int)


@contextmanager
def exit_watchdog(seconds: float, status: int, message: str = "") -> Iterator[None]:
    """End the process with a status if the context takes longer.

    FastDDS 2.14 can wait for itself for ever when a participant is destroyed at the moment when
    another one leaves (``DomainParticipant::set_listener``), and does not release Python's lock
    while it waits. So the handler is one of C, which needs no lock. Only the good-bye is lost:
    others see the node until its lease expires.

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

    handler = _Handler(end)
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


QUIET = 0.1  # s without a change
PATIENCE = 2.0  # s for the graph to be quiet
CLOSE_PATIENCE = 10.0  # s
_STUCK = (
    "seft: the middleware does not let this process leave the graph (a fault of FastDDS); it is "
    "ended here, and what was recorded is complete"
)


def leave_graph(node: "Node") -> None:
    """Take a node off the graph, when no other node leaves, and end its context.

    Of some hundred processes that leave at the same time one hangs, see `exit_watchdog`.
    """
    import rclpy

    _wait_for_quiet(node)
    with exit_watchdog(CLOSE_PATIENCE, 1, _STUCK):
        node.destroy_node()
        is_default = node.context is rclpy.get_default_context()
        rclpy.try_shutdown(context=None if is_default else node.context)  # it can begin anew


def _wait_for_quiet(node: "Node") -> None:
    deadline, seen, since = time.monotonic() + PATIENCE, None, 0.0
    while (now := time.monotonic()) < deadline:
        names = sorted(node.get_node_names_and_namespaces())
        if names != seen:
            seen, since = names, now
        elif now - since > QUIET:
            return
        time.sleep(QUIET / 10)
