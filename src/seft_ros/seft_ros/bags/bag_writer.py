"""Write a bag that survives its process: a killed recorder loses at most a quarter of a second."""

import errno
import os
import shutil
import sqlite3
import time
from collections.abc import Iterator
from contextlib import suppress
from itertools import chain, islice
from pathlib import Path
from types import TracebackType
from typing import Self

from rosbags.rosbag2 import StoragePlugin, WriterError
from seft_msgs_py.errors import ExperimentError, InputError, SeftError
from seft_msgs_py.wire.topics import Topic

from seft_ros.bags.bag_storage import (
    RESERVED,
    SPARE,
    Connections,
    Found,
    OpenFile,
    UnsyncedWriter,
    append,
    file_reason,
    flush_file,
    reserved_room,
    source_of,
    undo,
)

FLUSH_PERIOD = 0.25  # s of wall time
LONGEST_END = 10.0  # s for which there must be room, to record the end of a test
STORAGES = ("mcap", "sqlite3")


class BagWriter:
    """A rosbag2 bag (version 9) that is being written; use it in a ``with`` statement.

    Leaving the ``with`` closes the bag whatever the reason, so that it can be read. On a full
    disk it is closed with the messages so far, in room that was reserved for that. Only SIGKILL,
    a second Ctrl-C during closing or a disk that fails leave a bag without an end;
    `seft_ros.bags.bag_files.recover` makes a whole one of it.

    Parameters
    ----------
    path : path
        Folder to be made for the bag.
    storage : str
        ``mcap`` or ``sqlite3``.

    Attributes
    ----------
    path : Path
        The bag's folder.
    running_out : str
        A warning that the disk is nearly full; empty while there is room for a test's end.
    is_whole : bool
        Whether the bag is closed with all that it was given, and can be read.

    Raises
    ------
    InputError
        If something is there already, the folder can't be made, or the storage is unknown.
    """

    def __init__(self, path: str | Path, storage: str = "mcap") -> None:
        self.path = Path(path)
        self.running_out = ""
        self.is_whole = False
        if storage not in STORAGES:
            raise InputError(f"storage is {storage}, but must be one of {', '.join(STORAGES)}")
        there = self.path.exists()
        try:
            plugin = StoragePlugin[storage.upper()]
            self._writer = UnsyncedWriter(self.path, version=9, storage_plugin=plugin)
            self._writer.open()
            self._last = flush_file(self._writer)
            assert self._writer.storage is not None
            self._file = OpenFile(self._writer.storage.path)
            self._rooms = [reserved_room(self.path, size) for size in (RESERVED, SPARE)]
        except WriterError:
            raise InputError(f"{self.path} exists already; name another with --out") from None
        except (OSError, sqlite3.Error) as error:
            if not there:
                shutil.rmtree(self.path, ignore_errors=True)
            raise InputError(
                f"{self.path}: no bag can be made there ({file_reason(error)}); "
                "name another folder with --out"
            ) from None
        self._connections: Connections = {}
        self._unsafe: list[Found] = []  # messages since the last flush
        self._error: ExperimentError | None = None
        self._open = True
        self._flushed_at = self._began = time.monotonic()

    def write(self, topic: Topic, raw: bytes, time_ns: int) -> None:
        """Append a message.

        Parameters
        ----------
        topic : Topic
            The topic; the bag takes name, type and quality of service from it.
        raw : bytes
            The message in CDR, with its encapsulation header.
        time_ns : int
            When it was received, wall clock.

        Raises
        ------
        ExperimentError
            If the file can't be written any more, as on a full disk; then at every later call.
        """
        self.add((source_of(topic), time_ns, raw))

    def add(self, found: Found) -> None:
        """Append a message as another bag had it; raises as `write`."""
        if self._error is not None:
            raise self._error
        self._unsafe.append(found)
        try:
            append(self._writer, self._connections, found)
        except (OSError, sqlite3.Error) as error:
            self._mend(error)
        except BaseException:
            self._unsafe.pop()
            self._rewrite()
            raise
        self.flush_if_due()

    def flush_if_due(self) -> None:
        """Flush if `FLUSH_PERIOD` has passed; to be called also when nothing is written."""
        if time.monotonic() - self._flushed_at >= FLUSH_PERIOD:
            self.flush()

    def flush(self) -> None:
        """Make all messages so far survive this process; raises as `write`."""
        if self._error is not None:
            raise self._error
        if not self._open:
            return
        try:
            self._flush_now()
        except (OSError, sqlite3.Error) as error:
            self._mend(error)
        except BaseException:
            self._rewrite()
            raise
        self._flushed_at = time.monotonic()
        room = shutil.disk_usage(self._rooms[0].fileno()).free
        # a test's end takes as much room as the bag has taken so far in that time
        growth = self._file.size() / max(1.0, time.monotonic() - self._began)
        if room < RESERVED + growth * LONGEST_END:
            self.running_out = f"{self.path}: the disk is nearly full, {room >> 20} MiB are left"
        if room < RESERVED:  # before a write fails, which may lose earlier messages, too
            self._mend(OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))

    def close(self) -> None:
        """Write index and metadata; raises as `write`.

        Does nothing if the bag is closed or broken.
        """
        if not self._open or self._error is not None:
            return
        self.flush()
        for room in self._rooms:
            room.close()
        try:
            self._close_writer()
        except (OSError, sqlite3.Error) as error:
            raise self._broken(error) from None
        except BaseException:
            self._open = False
            self._writer.abort()
            raise

    def displaced(self) -> str:
        """Say whether the bag was deleted or moved; empty if it is in its place."""
        return self._file.displaced()

    def messages(self) -> Iterator[Found]:
        """Read all messages so far, also from a file that was moved or deleted."""
        flushed = sum(self._last.counts.values())
        return chain(islice(self._file.messages(), flushed), self._unsafe)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self.close()
        except SeftError:
            if error is None:  # else the reason for leaving counts
                raise

    def _flush_now(self) -> None:
        # in one statement: an interrupt finds messages in the file or in the list, not in both
        self._last, self._unsafe = flush_file(self._writer), []

    def _rewrite(self) -> None:
        """Write all messages since the last flush again, for the file may hold half of one."""
        undo(self._writer, self._last)
        known = self._writer.connections
        self._connections = {name: c for name, c in self._connections.items() if c in known}
        for found in self._unsafe:
            append(self._writer, self._connections, found)

    def _mend(self, error: Exception) -> None:
        """Write what did not fit into the spare room; if that is used up, end the bag."""
        self.running_out = f"{self.path}: {file_reason(error)}"
        while self._rooms:
            self._rooms.pop().close()
            with suppress(OSError, sqlite3.Error):
                self._rewrite()
                if self._rooms:
                    self._flush_now()
                    return
                self._close_writer()
                self._error = ExperimentError(
                    f"{self.path}: the bag ends here ({file_reason(error)}); what was recorded can "
                    "be read. Make room before the next test"
                )
        raise (self._error or self._broken(error)) from None

    def _close_writer(self) -> None:
        if self._file.displaced():
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))
        self._writer.close()
        self._open, self.is_whole = False, True

    def _broken(self, error: Exception) -> ExperimentError:
        self._open = False
        with suppress(OSError, sqlite3.Error):
            self._writer.abort()
        self._error = ExperimentError(
            f"{self.path}: the bag can't be written any more ({file_reason(error)}); fix that, "
            f"then recover what was recorded with: seft recover {self.path}"
        )
        return self._error
