"""Where a bag's file is while it is written: found through handles, whoever moves or deletes it."""

import os
import shutil
import tempfile
import weakref
from collections.abc import Iterator
from pathlib import Path

from rosbags.rosbag2 import Writer

from seft_ros.recording.salvage import Found, mcap_messages, sqlite_messages

_HANDLES = Path("/proc/self/fd")


class BagPlace:
    """Folder and file of a bag that is being written, kept open.

    A file that is deleted lives on as long as it is open, and its folder is known wherever it is
    moved to.

    Parameters
    ----------
    path : Path
        The folder, as it was named.
    writer : Writer
        Open; it will write its metadata into the folder wherever that is then.
    """

    def __init__(self, path: Path, writer: Writer) -> None:
        assert writer.storage is not None
        self._path, self._name = path, writer.storage.path.name
        self._folder = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
        weakref.finalize(self, os.close, self._folder)
        self._file = os.open(writer.storage.path, os.O_RDONLY)
        weakref.finalize(self, os.close, self._file)
        writer.metapath = _HANDLES / str(self._folder) / writer.metapath.name

    def size(self) -> int:
        """Size of the file, bytes."""
        return os.fstat(self._file).st_size

    def folder(self) -> Path:
        """Where the folder is now, as it was named if it is there."""
        handle = _HANDLES / str(self._folder)
        return self._path if self._is_at(self._path) else handle.readlink()

    def has_file(self) -> bool:
        """Tell whether the file is still in the folder under its name."""
        try:
            there = os.stat(self._name, dir_fd=self._folder)
        except OSError:
            return False
        return os.path.samestat(there, os.fstat(self._file))

    def displaced(self) -> str:
        """Say what has become of folder or file; empty if both are where they were made."""
        if not self.has_file():
            is_gone = os.fstat(self._file).st_nlink == 0
            what = "was deleted" if is_gone else "is not in its folder any more"
            return f"{self._path}: the bag {what}"
        if not self._is_at(self._path):
            return f"{self._path}: the bag was moved to {self.folder()}"
        return ""

    def messages(self) -> Iterator[Found]:
        """Messages in the file, in the order in which they were written; OSError where it fails."""
        file = _HANDLES / str(self._file)
        if self._name.endswith(".mcap"):
            yield from mcap_messages(file)
            return
        with tempfile.TemporaryDirectory() as folder:
            copy = Path(folder) / self._name
            shutil.copyfile(file, copy)
            yield from sqlite_messages(copy)

    def _is_at(self, path: Path) -> bool:
        try:
            return os.path.samestat(path.stat(), os.fstat(self._folder))
        except OSError:
            return False
