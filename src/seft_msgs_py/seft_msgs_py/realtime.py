"""Real-time priority, locked memory and a core of one's own, as far as the system grants them.

The parameters are called as those of ros2_control's controller manager.
"""

import ctypes
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from seft_msgs_py.parameters import Parameter

PARAMETERS = (
    Parameter(
        "thread_priority",
        "int",
        0,
        "real-time priority of the node's process (SCHED_FIFO); 0: none",
        minimum=0,
        maximum=98,
    ),
    Parameter(
        "lock_memory", "bool", False, "whether the node's memory is kept from being paged out"
    ),
    Parameter(
        "cpu_core",
        "int",
        -1,
        "processor core that the node keeps to; -1: as it was started",
        minimum=-1,
        maximum=4095,
    ),
)

_REMEDY = (
    "a line `{user} - {item} {value}` in /etc/security/limits.conf and a new login allow it; "
    "the test goes on without"
)
_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_PR_SET_TIMERSLACK, _SLACK_NS = 29, 1
_ADDR_NO_RANDOMIZE, _ASK = 0x0040000, 0xFFFFFFFF
_LIBC = ctypes.CDLL(None, use_errno=True)


def apply(section: Mapping[str, Any]) -> list[str]:
    """Ask for what a node's parameters say; whatever is denied is left as it was.

    Parameters
    ----------
    section : mapping
        Parameters of a node, among them `PARAMETERS`.

    Returns
    -------
    list of str
        What was denied, each with its remedy.
    """
    denied = []
    if section["cpu_core"] >= 0:
        denied.append(_keep_to_core(section["cpu_core"]))
    if section["lock_memory"]:
        denied.append(_lock_memory())
    if section["thread_priority"] > 0:
        denied.append(_take_priority(section["thread_priority"]))
    return [each for each in denied if each]


def wake_on_time() -> None:
    """Have the threads that this one will start, and itself, sleep no longer than they ask for.

    Else Linux may wake them up to 50 µs later, to save power.
    """
    _LIBC.prctl(_PR_SET_TIMERSLACK, _SLACK_NS, 0, 0, 0)


def take_equal_addresses() -> None:
    """Have the program that this process will execute put its parts where others put theirs.

    Else Linux spreads each program's parts at random (`personality(2)`). The nodes of the loop
    run the same interpreter and the same middleware, one after the other on one core; at equal
    addresses each finds the processor prepared by the one before it. Where a container's filter
    denies it, it changes nothing.
    """
    _LIBC.personality(_personality() | _ADDR_NO_RANDOMIZE)


def granted() -> dict[str, Any]:
    """Tell what this process has.

    Returns
    -------
    dict
        ``priority`` (real-time; 0: none), ``locked_kb``, ``cores``, ``equal_addresses``, and
        ``boot``, which is the same for all processes of a machine.
    """
    policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
    is_realtime = policy in (os.SCHED_FIFO, os.SCHED_RR)
    return {
        "priority": os.sched_getparam(0).sched_priority if is_realtime else 0,
        "locked_kb": _locked_kb(),
        "cores": sorted(os.sched_getaffinity(0)),
        "equal_addresses": bool(_personality() & _ADDR_NO_RANDOMIZE),
        "boot": boot(),
    }


def boot() -> str:
    """Tell one machine, from its start to its end, from all others; names no host."""
    return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()


def _personality() -> int:
    """Give this process's flags of `personality(2)`; none where even asking is denied."""
    return max(0, int(_LIBC.personality(_ASK)))


def _keep_to_core(core: int) -> str:
    try:
        for thread in _threads():
            os.sched_setaffinity(thread, {core})
    except OSError:
        allowed = ", ".join(str(each) for each in sorted(os.sched_getaffinity(0)))
        return f"core {core} is not to be had; choose cpu_core among {allowed}"
    return ""


def _take_priority(priority: int) -> str:
    """Raise all threads, those of DDS too: a message must not wait behind other processes.

    Threads that are made later, such as that of the services, have no priority.
    """
    try:
        for thread in _threads():
            policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
            os.sched_setscheduler(thread, policy, os.sched_param(priority))
    except OSError:
        return f"real-time priority {priority} is denied: " + _REMEDY.format(
            user="USER", item="rtprio", value=98
        )
    return ""


def _lock_memory() -> str:
    if _LIBC.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT):
        return "locked memory is denied: " + _REMEDY.format(
            user="USER", item="memlock", value="unlimited"
        )
    return ""


def _threads() -> list[int]:
    return [int(entry.name) for entry in Path("/proc/self/task").iterdir()]


def _locked_kb() -> int:
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith("VmLck"):
            return int(line.split()[1])
    return 0
