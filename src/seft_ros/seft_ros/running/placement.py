"""Which cores the processes of a test have, and how the kernel treats them there."""

import contextlib
import os
from collections.abc import Iterable
from typing import Self

from seft_msgs_py.node.realtime import side_threads, take_precedence
from seft_msgs_py.wire.rigs import bare

from seft_ros.running.arrangement import LOOP_NODES
from seft_ros.running.scheduling import prefer_latency, prefer_throughput


class Placement:
    """The loop's nodes on as many cores as there are rigs, and everything else off these.

    Parameters
    ----------
    nodes : iterable of str
        Names of the nodes that run on this machine.
    lockstep : bool
        Schedule the loop's nodes for throughput rather than for latency, until told otherwise.

    Attributes
    ----------
    loop, others : set of int
        Cores of the loop's nodes, and of all others.
    """

    def __init__(self, nodes: Iterable[str], *, lockstep: bool) -> None:
        cores = sorted(os.sched_getaffinity(0))
        rigs = max(1, sum(bare(node) == "rig" for node in nodes))  # they work side by side
        self.loop = set(cores[:rigs])
        self.others = set(cores[rigs:]) or set(cores)
        self._lockstep = lockstep

    @classmethod
    def where_it_helps(cls, nodes: Iterable[str], *, lockstep: bool) -> Self | None:
        """Place nodes where there is more than one core."""
        return cls(nodes, lockstep=lockstep) if len(os.sched_getaffinity(0)) > 1 else None

    def put(self, node: str, pid: int) -> None:
        """Put a process where its node belongs; to be called as soon as it is started.

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
            prefer_throughput(pid)
        else:
            _hurry(pid)

    def settle(self, pid: int, *, lockstep: bool) -> None:
        """Prepare a process of the loop for a test, whose pace is known by now.

        What no message of the loop passes through is moved off the loop's cores.
        """
        with contextlib.suppress(OSError):  # it has ended, as others will tell
            for thread in side_threads(pid):
                os.sched_setaffinity(thread, self.others)
            if self._lockstep and not lockstep:
                _hurry(pid)


def _hurry(pid: int) -> None:
    prefer_latency(pid)
    take_precedence(pid)
