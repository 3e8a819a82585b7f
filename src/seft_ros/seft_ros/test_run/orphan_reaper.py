"""Ends, from a separate process, the processes that a run leaves behind, even a killed run.

A pipe names the processes of the run, and its end shows that the run has ended, for whatever
reason. Nodes end with the run that started them, except those that a signal has stopped.
"""

import contextlib
import itertools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable
from typing import Self

from seft_msgs_py.node.realtime import process_stat

PATIENCE = 10.0  # s for nodes that the run did not end
POLL_PERIOD = 0.05  # s
_SEEN = b"seen\n"


class OrphanReaper:
    """Ends the processes that a run leaves behind; a context that waits for this at its end."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", __name__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C must not end it
        )

    def watch(self, pids: Iterable[int]) -> None:
        """Name the processes that the run has started."""
        pipe, answer = self._process.stdin, self._process.stdout
        assert pipe is not None and answer is not None
        with contextlib.suppress(BrokenPipeError):  # a test goes on without it
            pipe.write((" ".join(map(str, pids)) + "\n").encode())
            pipe.flush()
            answer.readline()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate()


def main() -> int:
    """Serve one run: lines of process numbers, until its end."""
    started: dict[int, str] = {}  # a process number may be used again
    for line in sys.stdin.buffer:
        pids = [int(word) for word in line.split()]
        started |= {pid: _start(pid) for pid in pids if pid not in started}
        sys.stdout.buffer.write(_SEEN)
        sys.stdout.buffer.flush()
    _end({pid: start for pid, start in started.items() if start})
    return 0


def _end(started: dict[int, str]) -> None:
    """Ask processes to end, wake those that a signal has stopped, and kill the remaining ones."""
    for numbers in ((signal.SIGTERM, signal.SIGCONT), (signal.SIGKILL,)):
        deadline = time.monotonic() + PATIENCE
        while left := [pid for pid, start in started.items() if _start(pid) == start]:
            for pid, number in itertools.product(left, numbers):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, number)
            if time.monotonic() > deadline:
                break
            time.sleep(POLL_PERIOD)


def _start(pid: int) -> str:
    """Time at which a process started, in ticks of the kernel; empty where it has ended.

    Of a killed process the first thread may be gone while others still hold its files.
    """
    fields = process_stat(pid)
    has_ended = not fields or (fields[0] == "Z" and int(fields[17]) <= 1)  # threads
    return "" if has_ended else fields[19]


if __name__ == "__main__":
    sys.exit(main())
