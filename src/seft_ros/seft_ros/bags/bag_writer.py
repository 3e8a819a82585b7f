"""Write a bag that survives its process: a killed recorder loses at most a quarter of a second."""

import errno
import os
import shutil
import sqlite3
import time
from collections.abc import Iterator
from contextlib import suppress
from itertools import islice
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, WriterError
from seft_msgs_py.errors import ExperimentError, InputError, SeftError
from seft_msgs_py.wire.topics import Topic

from seft_ros.bags.bag_storage import (
    RESERVED,
    SPARE,
    BagPlace,
    Found,
    McapStorage,
    Reserve,
    SqliteStorage,
    UnsyncedWriter,
    add_source,
    source_of,
)

FLUSH_PERIOD = 0.25  # s of wall time
LONGEST_END = 10.0  # s for which there must be room, to record the end of a test
STORAGES = ("mcap", "sqlite3")

Message = tuple[Topic, bytes, int]  # with the time in ns at which it was received


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
        The bag's folder; once the bag is closed, its present place if it was moved.
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
            self._writer = UnsyncedWriter(
                self.path, version=9, storage_plugin=StoragePlugin[storage.upper()]
            )
            self._writer.open()
            make = McapStorage if storage == "mcap" else SqliteStorage
            self._storage: McapStorage | SqliteStorage = make(self._writer)
            self._place = BagPlace(self.path, self._writer)
            self._reserve = Reserve(self.path, RESERVED)
            self._spare: Reserve | None = Reserve(self.path, SPARE)
        except WriterError:
            raise InputError(f"{self.path} exists already; name another with --out") from None
        except (OSError, sqlite3.Error) as error:
            if not there:
                shutil.rmtree(self.path, ignore_errors=True)
            raise InputError(
                f"{self.path}: no bag can be made there ({_reason(error)}); "
                "name another folder with --out"
            ) from None
        self._connections: dict[str, Connection] = {}
        self._safe = 0  # number of messages that are in the file
        self._unsafe: list[Message] = []  # those that may not be in it yet
        self._error: ExperimentError | None = None
        self._open = True
        self._flushed = self._began = time.monotonic()

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
        if self._error is not None:
            raise self._error
        mark, unsafe = self._storage.mark(), len(self._unsafe)
        self._unsafe.append((topic, raw, time_ns))
        try:
            self._append(topic, raw, time_ns)
        except (OSError, sqlite3.Error) as error:
            self._mend(error, mark, unsafe)
        except BaseException:
            self._undo(mark)
            del self._unsafe[unsafe:]
            raise
        self.flush_if_due()

    def copy(self, found: Found) -> None:
        """Append a message as another bag had it; raises as `write`."""
        source, time_ns, raw = found
        name = source.topic.lstrip("/")
        connection = self._connections.get(name)
        try:
            if connection is None:
                connection = add_source(self._writer, source)
                self._connections[name] = connection
            self._writer.write(connection, time_ns, raw)
        except (OSError, sqlite3.Error) as error:
            raise self._broken(error) from None

    def flush_if_due(self) -> None:
        """Flush if `FLUSH_PERIOD` has passed; to be called also when nothing is written."""
        if time.monotonic() - self._flushed >= FLUSH_PERIOD:
            self.flush()

    def flush(self) -> None:
        """Make all messages so far survive this process; raises as `write`."""
        if self._error is not None:
            raise self._error
        if not self._open:
            return
        mark = self._storage.mark()
        try:
            self._storage.flush()
        except (OSError, sqlite3.Error) as error:
            self._mend(error, mark, len(self._unsafe))
        self._now_safe()
        self._flushed = time.monotonic()
        room = self._reserve.beside()
        # a test's end takes as much room as the bag has taken so far in that time
        growth = self._place.size() / max(1.0, time.monotonic() - self._began)
        if room < RESERVED + growth * LONGEST_END:
            self.running_out = f"{self.path}: the disk is nearly full, {room >> 20} MiB are left"
        if room < RESERVED:  # before a write fails, which may lose earlier messages, too
            full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            self._mend(full, self._storage.mark(), 0)

    def close(self) -> None:
        """Write index and metadata; raises as `write`.

        Does nothing if the bag is closed or broken.
        """
        if not self._open or self._error is not None:
            return
        self.flush()
        for reserve in (self._spare, self._reserve):
            if reserve is not None:
                reserve.release()
        try:
            self._close_writer()
        except (OSError, sqlite3.Error) as error:
            raise self._broken(error) from None
        except BaseException:
            self._open = False
            self._writer.abort()
            raise

    def displaced(self) -> str:
        """Say whether folder or file was deleted or moved; empty if both are in place."""
        return self._place.displaced()

    def written(self) -> Iterator[Found]:
        """Read the messages that are in the file, wherever it is, even if it was deleted."""
        return islice(self._place.messages(), self._safe)

    def unwritten(self) -> list[Message]:
        """List the messages after those; some of them may be in the file, too."""
        return list(self._unsafe)

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

    def _append(self, topic: Topic, raw: bytes, time_ns: int) -> None:
        connection = self._connections.get(topic.name)
        if connection is None:
            connection = add_source(self._writer, source_of(topic))
        self._writer.write(connection, time_ns, raw)
        self._connections[topic.name] = connection

    def _undo(self, mark: Any) -> bool:
        holds = self._storage.undo(mark)
        known = {item.id for item in self._writer.connections}
        self._connections = {k: c for k, c in self._connections.items() if c.id in known}
        return holds

    def _now_safe(self) -> None:
        self._unsafe.clear()
        self._safe = sum(self._writer.counts.values())

    def _mend(self, error: Exception, mark: Any, again: int) -> None:
        """Write what did not fit into the spare room; if that is used up, end the bag.

        The first ``again`` of the unsafe messages were written before the mark.
        """
        if self._spare is not None:
            self._spare.release()
            self._spare = None
            self.running_out = f"{self.path}: {_reason(error)}"
            with suppress(OSError, sqlite3.Error):
                self._redo(mark, again)
                return
        self._reserve.release()
        try:
            self._redo(mark, again)
            self._close_writer()
        except (OSError, sqlite3.Error):
            raise self._broken(error) from None
        self._error = ExperimentError(
            f"{self.path}: the bag ends here ({_reason(error)}); what was recorded can be read. "
            "Make room before the next test"
        )
        raise self._error from None

    def _redo(self, mark: Any, again: int) -> None:
        holds = self._undo(mark)
        for message in self._unsafe[again if holds else 0 :]:
            self._append(*message)
        self._storage.flush()
        self._now_safe()

    def _close_writer(self) -> None:
        if not self._place.has_file():
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))
        self._writer.close()
        self._open, self.is_whole = False, True
        self.path = self._place.folder()

    def _broken(self, error: Exception) -> ExperimentError:
        self._open = False
        with suppress(OSError, sqlite3.Error):
            self._writer.abort()
        self._error = ExperimentError(
            f"{self.path}: the bag can't be written any more ({_reason(error)}); fix that, then "
            f"recover what was recorded with: seft recover {self.path}"
        )
        return self._error


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)
