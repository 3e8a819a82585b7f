"""Priority, locked memory, awake cores and a core of its own, as far as the system grants them.

The parameters have the names of ros2_control's controller manager.
"""

import contextlib
import ctypes
import os
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from seft_msgs_py.config.parameter_table import parameter_rows
from seft_msgs_py.node.transport import MACHINE

REALTIME_PARAMETERS = parameter_rows(
    """
    thread_priority | int  | 0     |  | 0 .. 98    |
        real-time priority of the node's process (SCHED_FIFO); 0: none
    lock_memory     | bool | false |  |            |
        whether the node's memory is kept from being paged out
    cpu_core        | int  | -1    |  | -1 .. 4095 |
        processor core on which the node runs; -1: no change
    keep_awake      | bool | false |  |            |
        whether the machine's cores stay awake while they wait, as long as the node runs
    """
)

FIRST_NICENESS = -20
"""The nice value of the process that runs before all others (`nice(1)`)."""
_TRIES = 20
_REMEDY = (
    "a line `USER - {} {}` in /etc/security/limits.conf and a new login allow it; the test "
    "continues without it"
)
_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_PR_SET_TIMERSLACK, _SLACK_NS = 29, 1
_AWAKE = Path("/dev/cpu_dma_latency")
_LIBC = ctypes.CDLL(None, use_errno=True)
_held: list[int] = []
"""Open files that keep cores awake, until they are closed."""


def apply(section: Mapping[str, Any]) -> list[str]:
    """Apply a section's `REALTIME_PARAMETERS`; return what was denied, each with its remedy."""
    core, priority = section["cpu_core"], section["thread_priority"]
    denied = (
        _keep_to_core(core) if core >= 0 else "",
        _keep_awake() if section["keep_awake"] else "",
        _lock_memory() if section["lock_memory"] else "",
        _take_priority(priority) if priority > 0 else "",
    )
    return [each for each in denied if each]


def wake_on_time() -> None:
    """Make this thread, and those that it will start, wake up on time.

    Otherwise Linux may wake them up to 50 µs later, to save power.
    """
    _LIBC.prctl(_PR_SET_TIMERSLACK, _SLACK_NS, 0, 0, 0)


def take_precedence(pid: int) -> bool:
    """Let a process run before all others without real-time priority; return if that was allowed.

    This includes the threads that it will start. Linux first schedules sessions, and then the
    processes of each (`sched(7)`, autogroup). So the session is raised, too, if the process has
    its own.
    """
    try:
        for thread in threads_of(pid):
            with contextlib.suppress(ProcessLookupError):  # it has ended meanwhile
                os.setpriority(os.PRIO_PROCESS, thread, FIRST_NICENESS)
        has_its_own = os.getsid(pid) == pid
    except OSError:
        return False
    if not has_its_own:
        return True
    session = Path(f"/proc/{pid}/autogroup")
    for _ in range(_TRIES):
        try:
            session.write_text(str(FIRST_NICENESS))
            break
        except BlockingIOError:  # the kernel takes ten a second
            MACHINE.sleep(0.1)
        except OSError:
            break  # there is no autogroup, or the process has ended
    return True


def may_keep_awake() -> bool:
    """Whether `REALTIME_PARAMETERS`' ``keep_awake`` would be granted."""
    return os.access(_AWAKE, os.W_OK)


def granted() -> dict[str, Any]:
    """Give what this process has: its real-time priority (0: none), nice value, cores...

    ``boot`` is the same for all processes of a machine, ``process`` identifies one of them.
    """
    policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
    is_realtime = policy in (os.SCHED_FIFO, os.SCHED_RR)
    return {
        "priority": os.sched_getparam(0).sched_priority if is_realtime else 0,
        "nice": os.getpriority(os.PRIO_PROCESS, 0),
        "locked_kb": memory_kb("VmLck"),
        "cores": sorted(os.sched_getaffinity(0)),
        "keeps_awake": bool(_held),
        "boot": boot(),
        "process": [os.getpid(), started(os.getpid())],
    }


def boot() -> str:
    """Identify this machine and its last start, without its name."""
    return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()


def started(pid: int) -> int:
    """Time at which a process of this machine started, in ticks of the kernel; -1: there is none.

    Process numbers are reused, and a container has its own.
    """
    stat = process_stat(pid)
    return int(stat[19]) if stat else -1


def process_stat(pid: int) -> list[str]:
    """Fields of ``/proc/PID/stat`` after the program's name; empty if there is no such process."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
    except OSError:
        return []
    return stat.rsplit(")", 1)[1].split()


def side_threads(pid: int | str = "self") -> list[int]:
    """Find the threads of a process through which no message of the loop passes.

    FastDDS names its threads: ``dds.udp.`` and a port receive, odd ports messages, even ports
    discovery (RTPS 2.3, 9.6.1.1); ``dds.ev`` and ``dds.asyn`` announce this process, which can take
    longer than a step's answer. OSError if there is no such process.
    """
    found = []
    for thread in threads_of(pid):
        try:
            name = Path(f"/proc/{pid}/task/{thread}/comm").read_text(encoding="utf-8").strip()
        except OSError:  # it has ended meanwhile
            continue
        _, _, port = name.partition("dds.udp.")
        if name.startswith(("dds.ev", "dds.asyn")) or (port.isdigit() and int(port) % 2 == 0):
            found.append(thread)
    return found


def _keep_to_core(core: int) -> str:
    try:
        for thread in set(threads_of()).difference(side_threads()):
            os.sched_setaffinity(thread, {core})
    except OSError:
        allowed = ", ".join(str(each) for each in sorted(os.sched_getaffinity(0)))
        return f"core {core} is not available; choose cpu_core among {allowed}"
    return ""


def _keep_awake() -> str:
    """Request no latency from the kernel: an idle core then polls.

    Waking a sleeping core takes long, also for the process that wakes it (Documentation/power/
    pm_qos_interface of the kernel).
    """
    try:
        held = os.open(_AWAKE, os.O_WRONLY)
        os.write(held, struct.pack("=i", 0))
    except OSError:
        return (
            f'to keep the cores awake is denied: a udev rule `KERNEL=="{_AWAKE.name}", '
            'GROUP="realtime", MODE="0660"` and a user in that group allow it; the test continues '
            "without"
        )
    _held.append(held)
    return ""


def _take_priority(priority: int) -> str:
    """Raise the priority of all threads, also of DDS: messages must not wait for other processes.

    Side threads wait only for the loop's threads, which may need their locks. Threads that are
    made later, such as that of the services, have no priority.
    """
    policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    try:
        aside = side_threads()
        for thread in threads_of():
            own = max(1, priority - 1) if thread in aside else priority
            os.sched_setscheduler(thread, policy, os.sched_param(own))
    except OSError:
        return f"real-time priority {priority} is denied: {_REMEDY.format('rtprio', 98)}"
    return ""


def _lock_memory() -> str:
    if _LIBC.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT):
        return f"locked memory is denied: {_REMEDY.format('memlock', 'unlimited')}"
    return ""


def threads_of(pid: int | str = "self") -> list[int]:
    """Numbers of the threads of a process."""
    return [int(entry.name) for entry in Path(f"/proc/{pid}/task").iterdir()]


def memory_kb(kind: str) -> int:
    """Memory of this process, kB: ``VmLck`` locked, ``VmHWM`` largest resident so far."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return next((int(at.split()[1]) for at in status.splitlines() if at.startswith(kind)), 0)
