"""The node processes of a test: which node in which, on which core; started, watched, ended."""

import contextlib
import ctypes
import os
import platform
import shutil
import signal
import struct
import tempfile
import time
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from seft_msgs_py.errors import ExperimentError, InputError
from seft_msgs_py.node import host
from seft_msgs_py.wire.topics import LOOP_NODES, NODES, bare, rig_name

from seft_ros.test_run.node_starter import NodeStarter

GIVES_WAY = {"force_controller": 1, "reference_force": 2}
"""By how much the priority of nodes that come earlier in a step is lower: the work that they do
after sending their message must wait until the step is done."""
LATENCY_SLICE_NS = 100_000
"""The shortest slice that Linux grants."""

_SYS_SCHED_SETATTR = {"x86_64": 314, "aarch64": 274}.get(platform.machine())
_SCHED_ATTR = struct.Struct("=IIQiIQQQ")  # size, policy, flags, nice, priority, runtime, ...
_LIBC = ctypes.CDLL(None, use_errno=True)


class Placement:
    """Everything but the loop's nodes stays off as many cores as there are rigs.

    In lockstep the loop's nodes stay on these. In real time they may use all cores, before others:
    what they do after an answer then delays nobody, and what has queued in a stall of the host is
    made up for.

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
        self._all = set(cores)
        self.loop = set(cores[:rigs]) if lockstep else self._all
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
        in_loop = bare(node) in LOOP_NODES
        for thread in host.threads_of(pid):  # those that it makes from now on inherit this
            os.sched_setaffinity(thread, self.loop if in_loop else self.others)
            if in_loop and self._lockstep:
                os.sched_setscheduler(thread, os.SCHED_BATCH, os.sched_param(0))
        if in_loop and not self._lockstep:
            _request_low_latency(pid)

    def settle(self, pid: int, *, lockstep: bool) -> None:
        """Prepare a process of the loop for a test; the pace is known by now.

        Threads through which no message of the loop passes are moved off the loop's cores.
        """
        with contextlib.suppress(OSError):  # it has ended; `ended` says how
            if self._lockstep and not lockstep:
                for thread in host.threads_of(pid):
                    os.sched_setaffinity(thread, self._all)
                _request_low_latency(pid)
            for thread in host.side_threads(pid):
                os.sched_setaffinity(thread, self.others)


def _request_low_latency(pid: int) -> None:
    prefer_latency(pid)
    host.take_precedence(pid)


def prefer_latency(pid: int) -> None:
    """Ask for short slices, and so to run soon after being woken; it needs no privilege.

    Linux 6.12 and later heed this (`sched_setattr(2)`, EEVDF). It has no effect on earlier ones, on
    processors whose call number is not known here, and on threads of real-time priority.
    """
    if _SYS_SCHED_SETATTR is None:
        return
    size = _SCHED_ATTR.size
    attributes = _SCHED_ATTR.pack(size, os.SCHED_OTHER, 0, 0, 0, LATENCY_SLICE_NS, 0, 0)
    for thread in host.threads_of(pid):
        with contextlib.suppress(ProcessLookupError):  # it has ended meanwhile
            if os.sched_getscheduler(thread) in (os.SCHED_OTHER, os.SCHED_BATCH):
                _LIBC.syscall(_SYS_SCHED_SETATTR, thread, attributes, 0)


@dataclass(frozen=True)
class ProcessLayout:
    """Where the nodes of a test run.

    Attributes
    ----------
    pin : bool
        See `Placement`. All cores stay awake, where that is allowed.
    composed : bool
        Put the loop's nodes into one process; with several rigs, each rig's own.
    priority : int
        Real-time priority (of the rig; the others' are a little lower), locked memory and awake
        cores for the loop's nodes; 0: none.
    """

    pin: bool = True
    composed: bool = False
    priority: int = 0

    def realtime_parameters(self, node: str) -> dict[str, Any]:
        """Parameters by which a node of the loop asks the system for what it needs."""
        if self.priority:
            below = 0 if self.composed else GIVES_WAY.get(node, 0)
            priority = max(1, self.priority - below)
            return {"thread_priority": priority, "lock_memory": True, "keep_awake": True}
        return {"keep_awake": True} if self.pin and host.may_keep_awake() else {}

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


MODULES = {node: f"seft_ros.nodes.{node}_node" for node in NODES}
MODULES["rig"] = "seft_plant_sim.rig_node"
"""Module of each node, for ``python -m``: it works with and without a ROS installation."""
COMPOSED = "seft_ros.nodes.loop_node"


class NodeProcesses:
    """Processes of some nodes, each with its log file; a context that ends them in any case.

    Parameters
    ----------
    starter : NodeStarter
        Starts them.
    nodes : iterable of str
        Names of the nodes.
    arguments : sequence of str
        Words by which each gets its parameters, see `Experiment.arguments`.
    layout : ProcessLayout
        Where they run.
    lockstep : bool
        Schedule the loop's nodes for throughput rather than for latency, until `settle`.
    bag : Path, optional
        Folder of the test's bag.

    Attributes
    ----------
    bag : Path or None
        Where the test's bag is. The logs are kept in it, if it exists at the end.
    pids : dict
        Numbers of the processes by node.
    """

    def __init__(
        self,
        starter: NodeStarter,
        nodes: Iterable[str],
        arguments: Sequence[str],
        layout: ProcessLayout,
        *,
        lockstep: bool,
        bag: Path | None = None,
    ) -> None:
        self._starter, self._arguments, self.bag, nodes = starter, arguments, bag, list(nodes)
        self._logs = Path(tempfile.mkdtemp(prefix="seft-"))
        self._cores = os.sched_getaffinity(0)
        self._placement = layout.placement(nodes, lockstep=lockstep)
        if self._placement is not None:
            os.sched_setaffinity(0, self._placement.others)  # this process, too
        self._logs_of: dict[str, Path] = {}
        self.pids: dict[str, int] = {}
        try:
            for group in layout.groups(nodes):
                self.pids.update(dict.fromkeys(group, self._start(group)))
        except BaseException:
            self.stop(0.0)
            shutil.rmtree(self._logs, ignore_errors=True)
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self.stop()
            if self.bag is not None and self.bag.is_dir():
                shutil.copytree(self._logs, self.bag / "logs", dirs_exist_ok=True)
        finally:
            shutil.rmtree(self._logs, ignore_errors=True)

    def ended(self) -> dict[str, str]:
        """Nodes whose process has ended: how it ended, with the last line it wrote about it."""
        found = {}
        for node in self.pids:
            if (code := self.exit_status(node)) is not None:
                how = f"killed by signal {-code}" if code < 0 else f"exit status {code}"
                found[node] = f"node {node} ended ({how}): {self._last_line(node)}"
        return found

    def raise_if_ended(self) -> None:
        """Check that all processes run.

        Raises
        ------
        InputError
            If one has found its input wrong.
        ExperimentError
            If one has ended otherwise.
        """
        for node, how in self.ended().items():
            raise (InputError if self.exit_status(node) == 2 else ExperimentError)(how)

    def stopped(self) -> list[str]:
        """Nodes whose process a signal has stopped."""
        return [node for node, pid in self.pids.items() if host.process_stat(pid)[:1] == ["T"]]

    def exit_status(self, node: str) -> int | None:
        """Exit status of a node's process; None while it runs."""
        return self._starter.status(self.pids[node])

    def settle(self, *, lockstep: bool) -> None:
        """Prepare the loop's nodes for a test, when its pace is known."""
        if self._placement is None:
            return
        for node, pid in self.pids.items():
            if bare(node) in LOOP_NODES:
                self._placement.settle(pid, lockstep=lockstep)

    def stop(self, patience: float = 10.0) -> None:
        """Ask all processes to end, and kill what has not after ``patience`` seconds."""
        for pid in set(self.pids.values()):
            self._starter.signal(pid, signal.SIGINT, signal.SIGCONT)  # a stopped one ends, too
        deadline = time.monotonic() + patience
        for pid in self.pids.values():
            while self._starter.status(pid, max(0.01, deadline - time.monotonic())) is None:
                self._starter.signal(pid, signal.SIGKILL)
        os.sched_setaffinity(0, self._cores)  # as before

    def _start(self, group: tuple[str, ...]) -> int:
        names, rig = [bare(node) for node in group], rig_name(group[0])
        words = [MODULES[names[0]]] if len(group) == 1 else [COMPOSED, "--nodes", *names]
        # the log has all that the process writes; rclpy would write it once more into a file
        words += ["--ros-args", "--disable-external-lib-logs"]
        words += [*(["-r", f"__ns:=/{rig}"] if rig else []), *self._arguments]
        log = self._logs / ("_".join(node.replace("/", "_") for node in group) + ".log")
        self._logs_of.update(dict.fromkeys(group, log))
        pid = self._starter.start(words, log)
        if self._placement is not None:
            self._placement.put(names[0], pid)
        return pid

    def _last_line(self, node: str) -> str:
        lines = self._logs_of[node].read_text(errors="replace").strip().splitlines()
        problems = [line for line in lines if not line.startswith("[INFO]")]
        return problems[-1] if problems else "it wrote nothing about it"
