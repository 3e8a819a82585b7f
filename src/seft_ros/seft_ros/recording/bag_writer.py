"""Write a bag that survives: a killed recorder loses a quarter of a second at most."""

import errno
import os
import shutil
import sqlite3
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from itertools import islice
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, WriterError
from seft_msgs_py.errors import ExperimentError, InputError, SeftError
from seft_msgs_py.wire.topics import Topic

from seft_ros.recording.bag_place import BagPlace
from seft_ros.recording.bag_storage import (
    RESERVED,
    SPARE,
    BagStorage,
    McapStorage,
    Reserve,
    SqliteStorage,
    UnsyncedWriter,
)
from seft_ros.recording.bag_topics import add_source, add_topic
from seft_ros.recording.salvage import Found

FLUSH_PERIOD = 0.25  # s of wall time
LONGEST_END = 10.0  # s in which a test that is recorded can be brought down
STORAGES = ("mcap", "sqlite3")

Message = tuple[Topic, bytes, int]  # with the time in ns at which it was received


class BagWriter:
    """A rosbag2 bag (version 9) under way; use it in a ``with`` statement.

    Leaving the ``with`` closes the bag whatever the reason, so that it can be read. On a full
    disk it is closed with what came until then, in room that was kept for that. Only SIGKILL, a
    second Ctrl-C during closing or a disk that fails leave a bag without an end;
    `seft_ros.recording.recover` makes a whole one of it.

    Parameters
    ----------
    path : path
        Folder to be made for the bag.
    storage : str
        ``mcap`` or ``sqlite3``.

    Attributes
    ----------
    path : Path
        The bag's folder; where it was moved to, once the bag is closed.
    running_out : str
        That the disk is nearly full; empty as long as there is room for a test's end.

    Raises
    ------
    InputError
        If something is there already, the folder can't be made, or the storage is unknown.
    """

    def __init__(self, path: str | Path, storage: str = "mcap") -> None:
        self.path = Path(path)
        self.running_out = ""
        if storage not in STORAGES:
            raise InputError(f"storage is {storage}, but must be one of {', '.join(STORAGES)}")
        there = self.path.exists()
        try:
            self._writer = UnsyncedWriter(
                self.path, version=9, storage_plugin=StoragePlugin[storage.upper()]
            )
            self._writer.open()
            make = McapStorage if storage == "mcap" else SqliteStorage
            self._storage: BagStorage = make(self._writer)
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
        self._safe = 0  # messages that the file has
        self._unsafe: list[Message] = []  # what it may not have yet
        self._error: ExperimentError | None = None
        self._open, self._whole = True, False
        self._flushed = self._began = time.monotonic()

    def write(self, topic: Topic, raw: bytes, time_ns: int) -> None:
        """Append a message.

        Parameters
        ----------
        topic : Topic
            What it was sent on; the bag learns name, type and quality of service of it.
        raw : bytes
            The message in CDR, with its encapsulation header.
        time_ns : int
            When it was received, wall clock.

        Raises
        ------
        ExperimentError
            If the file can't be written any more, as on a full disk; and at every call after.
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
        """Flush if the last time is `FLUSH_PERIOD` ago, also when nothing is written."""
        if time.monotonic() - self._flushed >= FLUSH_PERIOD:
            self.flush()

    def flush(self) -> None:
        """Make all that was written safe from this process's death; raises as `write`."""
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
        if room < RESERVED + self._bytes_of_an_end():
            self.running_out = f"{self.path}: the disk is nearly full, {room >> 20} MiB are left"
        if room < RESERVED:  # sooner than a write fails, which may take others with it
            full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            self._mend(full, self._storage.mark(), 0)

    def close(self, custom_data: Mapping[str, str] | None = None) -> None:
        """Write index and metadata, with ``custom_data``; raises as `write`.

        Does nothing if the bag is closed or broken.
        """
        if not self._open or self._error is not None:
            return
        self.flush()
        for key, value in (custom_data or {}).items():
            self._writer.set_custom_data(key, value)
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

    @property
    def is_whole(self) -> bool:
        """Whether the bag is closed with all that it was given, and can be read."""
        return self._whole

    def displaced(self) -> str:
        """Say what has become of the folder or its file; empty if they are where they were made."""
        return self._place.displaced()

    def written(self) -> Iterator[Found]:
        """Messages that are safe in the file, wherever it is, also of one that was deleted."""
        return islice(self._place.messages(), self._safe)

    def unwritten(self) -> list[Message]:
        """Messages that the bag was given after those; its file may have some of them."""
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
            if error is None:  # else the reason for leaving is what there is to tell
                raise

    def _append(self, topic: Topic, raw: bytes, time_ns: int) -> None:
        connection = self._connections.get(topic.name)
        if connection is None:
            connection = add_topic(self._writer, topic)
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

    def _bytes_of_an_end(self) -> float:
        """Room that a test needs to be brought down, bytes, as fast as the bag has grown so far."""
        return self._place.size() / max(1.0, time.monotonic() - self._began) * LONGEST_END

    def _mend(self, error: Exception, mark: Any, again: int) -> None:
        """Write on in spare room what did not fit; where that is used up, end the bag.

        Of the messages that are not safe, those before the number ``again`` are before the mark.
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
        self._open, self._whole = False, True
        self.path = self._place.folder()

    def _broken(self, error: Exception) -> ExperimentError:
        self._open = False
        with suppress(OSError, sqlite3.Error):
            self._writer.abort()
        self._error = ExperimentError(
            f"{self.path}: the bag can't be written on ({_reason(error)}); mend that, then get "
            f"back what was recorded with: seft recover {self.path}"
        )
        return self._error


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)
