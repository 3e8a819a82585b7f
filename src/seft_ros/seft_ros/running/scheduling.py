"""How the kernel treats the processes of a test; none of this needs privileges."""

import contextlib
import ctypes
import os
import platform
import signal
import struct

from seft_msgs_py.node.realtime import threads_of

LATENCY_SLICE_NS = 100_000
"""The shortest slice that Linux grants."""

_PR_SET_PDEATHSIG = 1
_SYS_SCHED_SETATTR = {"x86_64": 314, "aarch64": 274}.get(platform.machine())
_SCHED_ATTR = struct.Struct("=IIQiIQQQ")  # size, policy, flags, nice, priority, runtime, ...
_LIBC = ctypes.CDLL(None, use_errno=True)


def end_with_parent() -> None:
    """Have the kernel end the calling process when the one that started it dies."""
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def prefer_throughput(pid: int) -> None:
    """Let who is woken wait until who runs has done its work.

    A message to several readers then goes out to all before the first of them runs: more steps a
    second in lockstep, at the price of latency.
    """
    os.sched_setscheduler(pid, os.SCHED_BATCH, os.sched_param(0))


def prefer_latency(pid: int) -> None:
    """Ask for short slices, and so to run soon after being woken.

    Linux 6.12 and later heed this (`sched_setattr(2)`, EEVDF); to others, and on processors
    whose call number is not known here, it changes nothing. Nor to threads of real-time priority.
    """
    if _SYS_SCHED_SETATTR is not None:
        attributes = _SCHED_ATTR.pack(
            _SCHED_ATTR.size, os.SCHED_OTHER, 0, 0, 0, LATENCY_SLICE_NS, 0, 0
        )
        for thread in threads_of(pid):
            with contextlib.suppress(ProcessLookupError):  # it has ended meanwhile
                if os.sched_getscheduler(thread) in (os.SCHED_OTHER, os.SCHED_BATCH):
                    _LIBC.syscall(_SYS_SCHED_SETATTR, thread, attributes, 0)
