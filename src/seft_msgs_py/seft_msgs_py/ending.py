"""An end that does not hang."""

import ctypes
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager

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
