"""Files that a user names: others than regular ones may block or never end."""

import errno
import os
import stat
from pathlib import Path
from typing import IO

from seft_msgs_py.errors import InputError

NOT_REGULAR = "is no regular file; name another one"


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
