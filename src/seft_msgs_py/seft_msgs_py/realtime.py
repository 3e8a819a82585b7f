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


def granted() -> dict[str, Any]:
    """Tell what this process has.

    Returns
    -------
    dict
        ``priority`` (real-time; 0: none), ``locked_kb``, ``cores``, and ``boot``, which is the
        same for all processes of a machine.
    """
    policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
    is_realtime = policy in (os.SCHED_FIFO, os.SCHED_RR)
    return {
        "priority": os.sched_getparam(0).sched_priority if is_realtime else 0,
        "locked_kb": _locked_kb(),
        "cores": sorted(os.sched_getaffinity(0)),
        "boot": boot(),
    }


def boot() -> str:
    """Tell one machine, from its start to its end, from all others; names no host."""
    return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()


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
    if ctypes.CDLL(None, use_errno=True).mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT):
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
