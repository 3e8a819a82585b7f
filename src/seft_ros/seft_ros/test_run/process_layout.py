"""Which node of a test runs in which process, and which process on which core."""

import contextlib
import ctypes
import os
import platform
import struct
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

from seft_msgs_py.node.realtime import may_keep_awake, side_threads, take_precedence, threads_of
from seft_msgs_py.wire.topics import bare, rig_name

LOOP_NODES = ("rig", "reference_force", "force_controller")
"""Nodes that work one after the other within a step."""
GIVES_WAY = {"force_controller": 1, "reference_force": 2}
"""By how much the priority of nodes that come earlier in a step is lower: the work that they do
after sending their message must wait until the step is done."""
LATENCY_SLICE_NS = 100_000
"""The shortest slice that Linux grants."""

_SYS_SCHED_SETATTR = {"x86_64": 314, "aarch64": 274}.get(platform.machine())
_SCHED_ATTR = struct.Struct("=IIQiIQQQ")  # size, policy, flags, nice, priority, runtime, ...
_LIBC = ctypes.CDLL(None, use_errno=True)


class Placement:
    """The loop's nodes on as many cores as there are rigs, and everything else on the others.

    Parameters
    ----------
    nodes : collection of str
        Names of the nodes that run on this machine.
    lockstep : bool
        Schedule the loop's nodes for throughput rather than for latency, until `settle`.

    Attributes
    ----------
    loop, others : set of int
        Cores of the loop's nodes, and of all others.
    """

    def __init__(self, nodes: Collection[str], *, lockstep: bool) -> None:
        cores = sorted(os.sched_getaffinity(0))
        rigs = max(1, sum(bare(node) == "rig" for node in nodes))  # they work side by side
        self.loop = set(cores[:rigs])
        self.others = set(cores[rigs:]) or set(cores)
        self._lockstep = lockstep

    def put(self, node: str, pid: int) -> None:
        """Put a node's process on its core; call it as soon as the process is started.

        In lockstep a process that is woken waits until the running one has done its work. A message
        to several readers is then sent to all before the first of them runs: more steps a second,
        but a longer latency.

        Raises
        ------
        OSError
            If it has ended.
        """
        if bare(node) not in LOOP_NODES:
            os.sched_setaffinity(pid, self.others)
            return
        os.sched_setaffinity(pid, self.loop)
        if self._lockstep:
            os.sched_setscheduler(pid, os.SCHED_BATCH, os.sched_param(0))
        else:
            _hurry(pid)

    def settle(self, pid: int, *, lockstep: bool) -> None:
        """Prepare a process of the loop for a test, whose pace is known by now.

        Threads through which no message of the loop passes are moved off the loop's cores.
        """
        with contextlib.suppress(OSError):  # it has ended, which others report
            for thread in side_threads(pid):
                os.sched_setaffinity(thread, self.others)
            if self._lockstep and not lockstep:
                _hurry(pid)


def _hurry(pid: int) -> None:
    prefer_latency(pid)
    take_precedence(pid)


def prefer_latency(pid: int) -> None:
    """Ask for short slices, and so to run soon after being woken; it needs no privilege.

    Linux 6.12 and later heed this (`sched_setattr(2)`, EEVDF). It has no effect on earlier ones, on
    processors whose call number is not known here, and on threads of real-time priority.
    """
    if _SYS_SCHED_SETATTR is None:
        return
    size = _SCHED_ATTR.size
    attributes = _SCHED_ATTR.pack(size, os.SCHED_OTHER, 0, 0, 0, LATENCY_SLICE_NS, 0, 0)
    for thread in threads_of(pid):
        with contextlib.suppress(ProcessLookupError):  # it has ended meanwhile
            if os.sched_getscheduler(thread) in (os.SCHED_OTHER, os.SCHED_BATCH):
                _LIBC.syscall(_SYS_SCHED_SETATTR, thread, attributes, 0)


@dataclass(frozen=True)
class ProcessLayout:
    """Where the nodes of a test run.

    Attributes
    ----------
    pin : bool
        Keep the loop's nodes on one core and the others off it. They work in turn, so that a
        second core would only add wake-ups across cores. Several rigs work side by side, and have
        as many cores. All cores stay awake, where that is allowed.
    composed : bool
        Put the loop's nodes into one process; with several rigs, each rig's own.
    priority : int
        Real-time priority (of the rig; the others' are a little lower), locked memory and awake
        cores for the loop's nodes; 0: none.
    """

    pin: bool = True
    composed: bool = False
    priority: int = 0

    def wishes(self, node: str) -> dict[str, Any]:
        """Parameters by which a node of the loop asks the system for what it needs."""
        if self.priority:
            below = 0 if self.composed else GIVES_WAY.get(node, 0)
            priority = max(1, self.priority - below)
            return {"thread_priority": priority, "lock_memory": True, "keep_awake": True}
        return {"keep_awake": True} if self.pin and may_keep_awake() else {}

    def groups(self, nodes: Collection[str]) -> list[tuple[str, ...]]:
        """Sort nodes into processes, in order."""
        if not self.composed:
            return [(node,) for node in nodes]
        together: dict[str, list[str]] = {}  # by rig, in the order of the loop
        for name in LOOP_NODES:
            for node in nodes:
                if bare(node) == name:
                    together.setdefault(rig_name(node), []).append(node)
        alone = [(node,) for node in nodes if bare(node) not in LOOP_NODES]
        return [*alone, *map(tuple, together.values())]

    def placement(self, nodes: Collection[str], *, lockstep: bool) -> Placement | None:
        """Assign cores to nodes, if that is wanted and there is more than one core."""
        helps = self.pin and len(os.sched_getaffinity(0)) > 1
        return Placement(nodes, lockstep=lockstep) if helps else None
