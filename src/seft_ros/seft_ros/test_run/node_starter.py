"""Starts the nodes of a run from a separate process, and ends those that it leaves behind.

Imports take longest at the start of a node. This process imports once what the nodes need, and each
node is a fork of it. All nodes are then at equal addresses, so that those of the loop, which work
in turn on one core, find the processor's caches prepared by each other.

The run sends the words of each node to be started, and its log. It gets the number of the process
when it has started, and again with the exit status when it has ended. The end of the connection
shows that the run has ended, for whatever reason, also if it was killed.
"""

import contextlib
import ctypes
import gc
import importlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from multiprocessing import get_context
from multiprocessing.connection import Connection, Pipe, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Self

import numpy as np
from seft_msgs_py.errors import ExperimentError
from seft_msgs_py.node.host import process_stat
from seft_msgs_py.wire.messages import typestore
from setproctitle import setproctitle

IMPORTED = (
    "seft_ros.bags.bag_writer",
    "seft_ros.test_run.compiled_loop",
    "seft_ros.test_run.peers",
)
"""Most of what nodes import. None imports rclpy, whose tracer starts threads: only a process of one
thread may be forked."""
_END_TIMEOUT_S = 10.0  # s for nodes that the run did not end
_POLL_PERIOD = 0.05  # s
_PR_SET_PDEATHSIG = 1


class NodeStarter:
    """Starts nodes, and knows how they ended; a context that waits for the end of all of them.

    Parameters
    ----------
    imported : sequence of str
        Modules that nodes find imported; none of them may import rclpy.
    """

    def __init__(self, imported: Sequence[str] = IMPORTED) -> None:
        self._connection, theirs = Pipe()
        self._process = subprocess.Popen(
            [sys.executable, "-m", __name__, str(theirs.fileno()), *imported],
            stdin=subprocess.DEVNULL,
            stdout=2,  # as stderr
            pass_fds=[theirs.fileno()],
            start_new_session=True,  # Ctrl-C must not end it
        )
        theirs.close()
        self._statuses: dict[int, int | None] = {}  # None: it runs
        self._is_lost = False

    def start(self, words: Sequence[str], log: Path) -> int:
        """Start ``python -m`` with these words, writing to ``log``; give the process number.

        Raises
        ------
        ExperimentError
            If the starter has ended.
        """
        with contextlib.suppress(OSError):  # it has ended
            self._connection.send((list(words), str(log)))
        before = len(self._statuses)
        while len(self._statuses) == before:
            if self._is_lost:
                raise ExperimentError("the process that starts the nodes has ended")
            self._read(None)
        return list(self._statuses)[before]

    def status(self, pid: int, timeout: float = 0.0) -> int | None:
        """Exit status, or the negative number of a signal, after at most ``timeout`` s, or None."""
        deadline = time.monotonic() + timeout
        while self._statuses[pid] is None:
            self._read(max(0.0, deadline - time.monotonic()))
            if self._is_lost and not process_stat(pid):
                self._statuses[pid] = -signal.SIGTERM  # which the kernel has sent to it
            if time.monotonic() >= deadline:
                break
        return self._statuses[pid]

    def signal(self, pid: int, *numbers: int) -> None:
        """Send signals to a node, unless it has ended."""
        with contextlib.suppress(ProcessLookupError):
            for number in numbers if self.status(pid) is None else ():
                os.kill(pid, number)

    def _read(self, timeout: float | None) -> None:
        """Take in what the starter reports within a time; None: any time."""
        if self._is_lost:
            time.sleep(min(timeout or 0.0, _POLL_PERIOD))
            return
        try:
            while self._connection.poll(timeout):
                pid, status = self._connection.recv()
                self._statuses[pid] = status
                timeout = 0.0
        except (EOFError, OSError):
            self._is_lost = True

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.close()
        self._process.wait()


def main() -> int:
    """Serve one run."""
    connection = Connection(int(sys.argv[1]))
    for module in sys.argv[2:]:
        importlib.import_module(module)
    if "numba" in sys.modules:
        _prepare()
    gc.collect()
    gc.freeze()  # a collection would write to the pages that the nodes share
    fork, running = get_context("fork"), dict[int, BaseProcess]()  # by what shows their end
    with contextlib.suppress(EOFError, OSError):  # the run has ended
        while True:
            ready = wait([connection, *running])
            for one in [running.pop(each) for each in ready if each in running]:
                one.join()
                connection.send((one.pid, one.exitcode))
            if connection in ready:
                node = fork.Process(target=_run, args=(connection.recv(), connection))
                node.start()
                running[node.sentinel] = node
                connection.send((node.pid, None))
    _end(list(running.values()))
    return 0


def _prepare() -> None:
    """Do once what nodes would do at their first message and their first machine code."""
    from seft_plant_sim.compiled import entry_point, is_finite  # which takes most of a start

    typestore()
    entry_point(is_finite, np.zeros((1, 1)), 0)


def _run(request: tuple[list[str], str], connection: Connection) -> None:
    """Be a process of one's own, as if ``python -m`` had just started it; run a node."""
    (name, *words), log = request
    os.setsid()  # the run passes Ctrl-C on, in order
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    connection.close()
    written = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
    for number in (1, 2):
        os.dup2(written, number)
    os.close(written)
    sys.argv = [name, *words]
    setproctitle(" ".join([sys.executable, "-m", name, *words]))
    sys.exit(importlib.import_module(name).main())


def _end(running: list[BaseProcess]) -> None:
    """Ask processes to end, wake those that a signal has stopped, and kill the remaining ones."""
    for numbers in ((signal.SIGTERM, signal.SIGCONT), (signal.SIGKILL,)):
        deadline = time.monotonic() + _END_TIMEOUT_S
        while (left := [one for one in running if one.is_alive()]) and time.monotonic() < deadline:
            for pid in [one.pid for one in left if one.pid]:
                for number in numbers:
                    os.kill(pid, number)
            time.sleep(_POLL_PERIOD)


if __name__ == "__main__":
    sys.exit(main())
