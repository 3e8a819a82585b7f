"""Starts the nodes of a run from a separate process, and ends those that it leaves behind.

Imports take longest at the start of a node. This process imports once what the nodes need, and each
node is a fork of it. All nodes are then at equal addresses, so that those of the loop, which work
in turn on one core, find the processor's caches prepared by each other.

Its input names the nodes to be started, a line of JSON each. Its output reports each process: its
number when it has started, its number and exit status when it has ended. The end of its input shows
that the run has ended, for whatever reason, also if it was killed.
"""

import contextlib
import ctypes
import gc
import importlib
import json
import os
import select
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

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
_LIBC = ctypes.CDLL(None)


class NodeStarter:
    """Starts nodes, and knows how they ended; a context that waits for the end of all of them.

    Parameters
    ----------
    imported : sequence of str
        Modules that nodes find imported; none of them may import rclpy.
    """

    def __init__(self, imported: Sequence[str] = IMPORTED) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", __name__, *imported],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C must not end it
        )
        self._started: list[int] = []
        self._ended: dict[int, int] = {}
        self._unread = b""
        self._is_lost = False

    def start(self, words: Sequence[str], log: Path) -> int:
        """Start ``python -m`` with these words, writing to ``log``; give the process number.

        Raises
        ------
        ExperimentError
            If the starter has ended.
        """
        request = {"words": list(words), "log": str(log)}
        assert self._process.stdin is not None
        before = len(self._started)
        try:
            self._process.stdin.write(json.dumps(request).encode() + b"\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            self._is_lost = True
        while len(self._started) == before:
            if self._is_lost:
                raise ExperimentError("the process that starts the nodes has ended")
            self._read(None)
        return self._started[-1]

    def status(self, pid: int, timeout: float = 0.0) -> int | None:
        """Exit status, or the negative number of a signal, after at most ``timeout`` s, or None."""
        deadline = time.monotonic() + timeout
        while pid not in self._ended:
            self._read(max(0.0, deadline - time.monotonic()))
            if self._is_lost and not process_stat(pid):
                self._ended.setdefault(pid, -signal.SIGTERM)  # which the kernel has sent to it
            if time.monotonic() >= deadline:
                break
        return self._ended.get(pid)

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
        assert self._process.stdout is not None
        file = self._process.stdout.fileno()
        if not select.select([file], [], [], timeout)[0]:
            return
        read = os.read(file, 4096)
        self._is_lost = not read
        *lines, self._unread = (self._unread + read).split(b"\n")
        for line in lines:
            pid, *status = map(int, line.split())
            if pid not in self._started:
                self._started.append(pid)
            if status:
                self._ended[pid] = status[0]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate()


def main() -> int:
    """Serve one run."""
    report = os.dup(1)
    os.dup2(2, 1)
    for module in sys.argv[1:]:
        importlib.import_module(module)
    if "numba" in sys.modules:
        _prepare()
    gc.collect()
    gc.freeze()  # a collection would write to the pages that the nodes share
    woken, wake = os.pipe()
    os.set_blocking(wake, False)
    signal.set_wakeup_fd(wake, warn_on_full_buffer=False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    running: set[int] = set()
    unread = b""
    while True:
        ready, _, _ = select.select([0, woken], [], [])
        if woken in ready:
            os.read(woken, 4096)
            _report_ended(running, report)
        if 0 in ready:
            read = os.read(0, 65536)
            if not read:
                break
            *lines, unread = (unread + read).split(b"\n")
            running |= {_fork(json.loads(line), report) for line in lines}
    _end(running, report)
    return 0


def _prepare() -> None:
    """Do once what nodes would do at their first message and their first machine code."""
    from seft_plant_sim.compiled import entry_point, is_finite  # which takes most of a start

    typestore()
    entry_point(is_finite, np.zeros((1, 1)), 0)


def _fork(request: dict[str, Any], report: int) -> int:
    """Start a node, and give the number of its process, which itself does not return."""
    pid = os.fork()
    if pid:
        return pid
    status = 1
    try:
        _begin(request, report)
        status = int(importlib.import_module(request["words"][0]).main() or 0)
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 1
    except BaseException:
        traceback.print_exc()
    finally:
        with contextlib.suppress(OSError):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(status)


def _begin(request: Mapping[str, Any], report: int) -> None:
    """Make this process one of its own, as if ``python -m`` had just started it."""
    os.setsid()  # the run passes Ctrl-C on, in order
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    os.write(report, b"%d\n" % os.getpid())
    signal.set_wakeup_fd(-1)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    nowhere = os.open(os.devnull, os.O_RDONLY)
    log = os.open(request["log"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
    for file, number in ((nowhere, 0), (log, 1), (log, 2)):
        os.dup2(file, number)
    os.closerange(3, os.sysconf("SC_OPEN_MAX"))
    name, *words = request["words"]
    sys.argv = [name, *words]
    setproctitle(" ".join([sys.executable, "-m", name, *words]))


def _report_ended(running: set[int], report: int) -> None:
    """Report each process that has ended, with its status as `subprocess` gives it."""
    for pid in list(running):
        found, how = os.waitpid(pid, os.WNOHANG)
        if found:
            running.discard(pid)
            with contextlib.suppress(BrokenPipeError):  # the run was killed
                os.write(report, b"%d %d\n" % (pid, os.waitstatus_to_exitcode(how)))


def _end(running: set[int], report: int) -> None:
    """Ask processes to end, wake those that a signal has stopped, and kill the remaining ones."""
    for numbers in ((signal.SIGTERM, signal.SIGCONT), (signal.SIGKILL,)):
        deadline = time.monotonic() + _END_TIMEOUT_S
        while running and time.monotonic() < deadline:
            for pid in running:
                for number in numbers:
                    os.kill(pid, number)  # it is still there, as nobody has waited for its end
            time.sleep(_POLL_PERIOD)
            _report_ended(running, report)


if __name__ == "__main__":
    sys.exit(main())
