"""Room on a disk that is kept for the end: a bag on a full disk can still be closed."""

import os
import tempfile
from pathlib import Path

RESERVED = 4 << 20
"""Bytes: an open chunk, and the index of a bag of hours."""


class Reserve:
    """Bytes of a file system that nobody else gets.

    They belong to a file without a name: a process that is killed leaves none.

    Parameters
    ----------
    folder : path
        On that file system.
    size : int
        How many.

    Raises
    ------
    OSError
        If there is not so much room.
    """

    def __init__(self, folder: Path, size: int = RESERVED) -> None:
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115  it is kept open
        self._size = size
        try:
            os.posix_fallocate(self._file.fileno(), 0, size)
        except OSError:
            self._file.close()
            raise

    def is_last(self) -> bool:
        """Tell whether less than that is left beside it."""
        system = os.fstatvfs(self._file.fileno())
        return system.f_bavail * system.f_frsize < self._size

    def release(self) -> None:
        """Give the room away."""
        self._file.close()
