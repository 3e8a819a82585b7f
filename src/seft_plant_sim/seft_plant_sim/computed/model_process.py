"""A computed model in a process of its own, as the loop sees it.

Whatever the model does (prints, exits, hangs, crashes, forks, closes files), this process receives
an answer or raises a `ModelError`, and the model's process ends with it. What the model prints goes
to stderr, line by line, without control characters.
"""

import contextlib
import marshal
import os
import re
import select
import signal
import subprocess
import sys
import time
import weakref
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from typing import Any, NoReturn

from seft_msgs_py.config.registered import printable
from seft_msgs_py.errors import InputError

from seft_plant_sim.computed.model_worker import MODEL_PARAMETER, PARTICIPLES

START_TIME = 60.0
"""s, for a model to be made, or to start: it may import OpenSees and build its structure."""
STEP_TIME = 5.0  # s, after which a step hangs
ENDING_TIME = 2.0  # s, for a model to close itself
LONGEST_OUTPUT = 20_000
"""Characters that are shown of what one process prints."""
_MAIN = "from seft_plant_sim.computed.model_worker import main; main()"
_HEADER = 4  # bytes with the size of a message of a `Connection`
_FRAME = re.compile(r'File "([^"<]+)", line (\d+) in ')


class ModelError(InputError):
    """A computed model can't be used, or has failed."""


class ModelProcess:
    """The process of one model; it lives no longer than the thread that makes it.

    Parameters
    ----------
    name, settings : str
        ``computed.model`` and ``computed.settings``.

    Attributes
    ----------
    axes : int, list of str or str
        Those of the model, see `ModelWorker.make`.

    Raises
    ------
    ModelError
        If the model can't be made.
    """

    def __init__(self, name: str, settings: str) -> None:
        self._name, self._in_flight, self._lines = name, "make", dict[str, int]()
        self._own, theirs = Pipe()
        written, output = os.pipe()
        self._trace = os.memfd_create("trace")
        passed = theirs.fileno(), self._trace
        words = "-u", "-P", "-c", _MAIN, *map(str, passed), name
        process = subprocess.Popen(
            [sys.executable, *words],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            pass_fds=passed,
            start_new_session=True,  # Ctrl-C is for those who ramp the test down
            env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        )
        theirs.close()
        os.close(output)
        self._process, self._ended = process, os.pidfd_open(process.pid)
        self._output = _Output(name, written)
        files = written, self._trace, self._ended
        self.close = weakref.finalize(
            self, _end, os.getpid(), self._own, process, self._output, files
        )
        """End the process; it ends with this object, too."""
        self._poller = select.poll()
        for file in (self._own.fileno(), written, self._ended):
            self._poller.register(file, select.POLLIN)
        self._send(list(sys.path), settings)
        self.axes, self._lines = self.request("make")

    def request(self, what: str, *arguments: Any) -> Any:
        """Call a method of `ModelWorker`; give its result."""
        self.begin(what, *arguments)
        return self.result()

    def begin(self, what: str, *arguments: Any) -> None:
        """Begin a call, whose result is due before the next one."""
        self._in_flight = what
        self._output.last = ""
        self._send(what, *arguments)

    def result(self) -> Any:
        """Wait for the result of the call.

        Raises
        ------
        ModelError
            If the model fails, gives no result in time, or has ended; its process then ends, too.
        """
        patience = STEP_TIME if self._in_flight == "step" else START_TIME
        deadline, received = time.monotonic() + patience, b""
        while len(received) < _HEADER + int.from_bytes(received[:_HEADER], "big"):  # the size
            left = max(0.0, deadline - time.monotonic())
            ready = {file for file, _ in self._poller.poll(1e3 * left)}
            if self._output.file in ready and not self._output.show():
                self._poller.unregister(self._output.file)
            if self._own.fileno() in ready:
                received += self._read()
            elif self._ended in ready:
                self._fail_ended()
            if not ready:
                self._fail_hanging(patience)
        try:
            is_done, reply = marshal.loads(received[_HEADER:])
        except (EOFError, TypeError, ValueError):  # whatever else the model wrote there
            self._fail("its answer can't be read")
        if not is_done:
            self.close()
            raise ModelError(f"{reply}{self._said()}")
        return reply

    @property
    def is_open(self) -> bool:
        """Whether it can take calls."""
        return self.close.alive

    def _send(self, *request: Any) -> None:
        with contextlib.suppress(OSError):  # it has ended: the result says how
            self._own.send_bytes(marshal.dumps(request))

    def _read(self) -> bytes:
        """Read what has come of a result: if the model disturbs that, no call may wait for it."""
        text = b""
        with contextlib.suppress(OSError):
            text = os.read(self._own.fileno(), 1 << 20)
        return text or self._fail_ended()

    def _fail_hanging(self, patience: float) -> NoReturn:
        os.kill(self._process.pid, signal.SIGABRT)  # it then tells where it is
        self._wait_for_end()
        self._fail(f"no answer within {patience:g} s{self._place()}")

    def _fail_ended(self) -> NoReturn:
        if not self._wait_for_end():
            self._fail("its process answers no more: it has closed the connection")
        if (code := self._process.wait()) < 0:
            self._fail(f"its process was ended by {signal.Signals(-code).name}{self._place()}")
        self._fail(f"its process has ended with exit status {code}{self._place()}")

    def _fail(self, why: str) -> NoReturn:
        """End the process, and raise the error of the call."""
        what, line = self._in_flight, self._lines.get(self._in_flight)
        where = f"{MODEL_PARAMETER}: {self._name}{f' line {line}' if line else ''}"
        self.close()
        raise ModelError(f"{where}, {PARTICIPLES.get(what, what)}: {why}{self._said()}")

    def _wait_for_end(self) -> bool:
        return bool(select.select([self._ended], [], [], ENDING_TIME)[0])

    def _place(self) -> str:
        """Tell the user's line at which the process ended, if it is known."""
        text = os.pread(self._trace, 65536, 0).decode(errors="replace")
        library = sys.base_prefix, sys.prefix, str(Path(__file__).parent)
        for file, line in _FRAME.findall(text):  # the innermost first
            if not file.startswith(library):
                return f" at {Path(file).name} line {line}"
        return ""

    def _said(self) -> str:
        return f" (it printed: {self._output.last})" if self._output.last else ""


class _Output:
    """Shows on stderr what a model prints, line by line."""

    def __init__(self, name: str, file: int) -> None:
        self._name, self.file, self._remainder = name, file, b""
        self._left = LONGEST_OUTPUT
        self.last = ""
        """The last line since this was set."""
        os.set_blocking(file, False)

    def show(self) -> bool:
        """Show what has come; return whether more can come."""
        with contextlib.suppress(BlockingIOError):
            while text := os.read(self.file, 65536):
                text = self._remainder + text
                if self._left <= 0:  # only the last line is of use
                    text = text[-LONGEST_OUTPUT:]
                *lines, self._remainder = text.split(b"\n")
                if len(self._remainder) > LONGEST_OUTPUT:
                    lines, self._remainder = [*lines, self._remainder], b""
                self._print(lines if self._left > 0 else lines[-1:])
            return False
        return True

    def show_all(self) -> None:
        """Show what has come, to its end."""
        self.show()
        self._print([self._remainder])

    def _print(self, lines: list[bytes]) -> None:
        for line in lines:
            shown = printable(line.decode(errors="replace"))
            self.last = shown or self.last
            if not shown or self._left <= 0:
                continue
            printed = f"{self._name}: {shown}"
            print(printed, file=sys.stderr)
            self._left -= len(printed)
            if self._left <= 0:
                print(f"{self._name}: (it prints more)", file=sys.stderr)


def _end(
    owner: int,
    own: Connection,
    process: subprocess.Popen[bytes],
    output: _Output,
    files: tuple[int, ...],
) -> None:
    """End a process and all that it has started, unless this is a fork of its owner."""
    own.close()
    if os.getpid() == owner:
        select.select([files[-1]], [], [], ENDING_TIME)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)  # its number is its own until it is waited for
        process.wait()
        output.show_all()
    for file in files:
        os.close(file)
