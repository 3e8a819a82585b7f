"""An end that does not hang."""

import ctypes
import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager

import rclpy
from rclpy.node import Node

_Handler = ctypes.CFUNCTYPE(None, ctypes.c_int)


@contextmanager
def ending_within(seconds: float, status: int, told: str = "") -> Iterator[None]:
    """End the process with a status if what is done inside takes longer.

    FastDDS 2.14 can wait for itself for ever when a participant is taken down in the moment in
    which another one leaves (``DomainParticipant::set_listener``), and it waits without giving
    Python a turn. So the handler is one of C, which needs none. All that is lost is the good-bye:
    others see the node until its lease runs out.

    Parameters
    ----------
    seconds : float
        Patience.
    status : int
        Exit status.
    told : str
        What to say then on stderr.
    """

    def end(_: int) -> None:
        if told:
            os.write(2, f"{told}\n".encode())
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
_TOLD = (
    "seft: the middleware does not let this process leave the graph (a fault of FastDDS); it is "
    "ended here, and what was recorded is complete"
)


def leave_graph(node: Node) -> None:
    """Take a node off the graph, when nobody else leaves, and end its context.

    See `ending_within` for why: of some hundred processes that leave together one hangs.
    """
    _wait_for_quiet(node)
    with ending_within(CLOSE_PATIENCE, 1, _TOLD):
        node.destroy_node()
        is_default = node.context is rclpy.get_default_context()
        rclpy.try_shutdown(context=None if is_default else node.context)  # it can begin anew


def _wait_for_quiet(node: Node) -> None:
    deadline, seen, since = time.monotonic() + PATIENCE, None, 0.0
    while (now := time.monotonic()) < deadline:
        names = sorted(node.get_node_names_and_namespaces())
        if names != seen:
            seen, since = names, now
        elif now - since > QUIET:
            return
        time.sleep(QUIET / 10)
