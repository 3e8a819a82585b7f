"""Text for a terminal, and standard output that nobody takes."""

import io
import os
import sys
from collections.abc import Buffer, Callable
from contextlib import suppress
from pathlib import Path
from typing import TextIO


def escaped(text: str) -> str:
    """Escape what is no printable character: a terminal may take it as a command. Lines stay."""
    if text.replace("\n", "").isprintable():
        return text
    return "".join(
        c if c.isprintable() or c == "\n" else c.encode("unicode_escape").decode() for c in text
    )


class _Output(io.RawIOBase):
    """A descriptor that takes all; after the first error what is written is discarded."""

    def __init__(self, file: int) -> None:
        self._file = file
        self.error: OSError | None = None

    def writable(self) -> bool:
        return True

    def fileno(self) -> int:
        return self._file

    def isatty(self) -> bool:
        return os.isatty(self._file)

    def write(self, data: Buffer) -> int:
        if self.error is None:
            try:
                return os.write(self._file, data)
            except OSError as error:
                self.error = error
        return memoryview(data).nbytes


def unbroken(program: str, main: Callable[[], int]) -> int:
    """Run a program to its end, also if stdout or stderr is full, or its reader leaves.

    A test that runs must not end by that, and no command ends with a traceback.

    Parameters
    ----------
    program : str
        Its name, for an error.
    main : callable
        Returns the exit status, or raises SystemExit with it.

    Returns
    -------
    int
        The program's exit status; 1 if it would be 0, but stdout was not taken to its end.
    """
    _open_closed()
    before, outputs = (sys.stdout, sys.stderr), (_Output(1), _Output(2))
    if any(not _is_file(stream, number) for number, stream in enumerate(before, start=1)):
        return main()  # something else takes what is printed
    sys.stdout, sys.stderr = map(_stream, before, outputs)
    try:
        try:
            status = main()
        except SystemExit as end:  # argparse
            status = end.code if isinstance(end.code, int) else 0
        sys.stdout.flush()
        if (error := outputs[0].error) is not None:
            print(f"{program}: stdout can't be written ({error.strerror})", file=sys.stderr)
            status = status or 1
        return status
    finally:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        sys.stdout, sys.stderr = before


def _open_closed() -> None:
    """Open what is closed of the three standard streams: the next file would take its place.

    What is printed to a closed stdout fails.
    """
    for name, mode in (("stdin", "r"), ("stdout", "r"), ("stderr", "w")):
        if getattr(sys, name) is None:
            stream = Path(os.devnull).open(mode)  # noqa: SIM115
            os.set_inheritable(stream.fileno(), True)
            setattr(sys, name, stream)


def _is_file(stream: TextIO | None, number: int) -> bool:
    """Say whether a stream is that of Python itself, of this descriptor."""
    with suppress(OSError, ValueError):
        return isinstance(stream, io.TextIOWrapper) and stream.fileno() == number
    return False


def _stream(old: TextIO, output: _Output) -> TextIO:
    assert isinstance(old, io.TextIOWrapper)
    lines = old.line_buffering or output.isatty()
    return io.TextIOWrapper(
        io.BufferedWriter(output), old.encoding, old.errors, line_buffering=lines
    )
