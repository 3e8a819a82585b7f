"""Files that a user names: others than regular ones may block or never end."""

import errno
import os
import select
import stat
from pathlib import Path
from typing import IO

from seft_msgs_py.errors import InputError

NOT_REGULAR = "is no regular file; name another one"
PIPE_WITHIN = 5.0
"""s, in which who writes to a pipe must write the first, or more."""


def open_regular(path: Path) -> IO[bytes]:
    """Open a file to be read; an OSError says why not, also of a folder, a pipe or a device."""
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY)
    mode = os.fstat(handle).st_mode
    if stat.S_ISREG(mode):
        return os.fdopen(handle, "rb")
    os.close(handle)
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    raise OSError(errno.EINVAL, NOT_REGULAR)


def read_text_of(path: Path, most: int) -> bytes:
    """Read so many bytes at most of a file, or of a pipe such as ``<(COMMAND)`` of a shell.

    An OSError says why not, also of a pipe to which nobody writes for `PIPE_WITHIN`.
    """
    if path.is_fifo():
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        try:
            return _read_pipe(handle, most)
        finally:
            os.close(handle)
    with open_regular(path) as file:
        return file.read(most)


def _read_pipe(handle: int, most: int) -> bytes:
    data, poller = b"", select.poll()
    poller.register(handle, select.POLLIN)
    while len(data) < most:
        try:
            part = os.read(handle, most - len(data))
        except BlockingIOError:
            part = b""
        else:
            if data and not part:
                break  # who wrote has left
        data += part
        if not part:  # nobody has written yet
            ready = poller.poll(1e3 * PIPE_WITHIN)
            if not ready:
                raise TimeoutError(
                    errno.ETIMEDOUT, f"nobody has written to this pipe within {PIPE_WITHIN:g} s"
                )
            if not ready[0][1] & select.POLLIN:
                break
    return data


def check_regular(path: Path) -> None:
    """Check that a file to be written is a regular one, if it exists.

    Raises
    ------
    InputError
        If it is a folder, a pipe or a device.
    """
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name a file in a folder that exists")
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: {NOT_REGULAR}")
