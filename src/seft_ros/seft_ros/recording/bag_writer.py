"""Write a bag that survives: a killed recorder loses a quarter of a second at most."""

import errno
import os
import shutil
import sqlite3
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, WriterError
from seft_msgs_py.errors import ExperimentError, InputError, SeftError
from seft_msgs_py.wire.topics import Topic

from seft_ros.recording.bag_storage import (
    BagStorage,
    McapStorage,
    SqliteStorage,
    UnsyncedWriter,
)
from seft_ros.recording.bag_topics import add_topic
from seft_ros.recording.reserve import Reserve

FLUSH_PERIOD = 0.25  # s of wall time
STORAGES = ("mcap", "sqlite3")


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

    Raises
    ------
    InputError
        If something is there already, the folder can't be made, or the storage is unknown.
    """

    def __init__(self, path: str | Path, storage: str = "mcap") -> None:
        self.path = Path(path)
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
            self._reserve = Reserve(self.path)
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
        self._error: ExperimentError | None = None
        self._open = True
        self._flushed = time.monotonic()

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
        mark = self._storage.mark()
        try:
            self._append(topic, raw, time_ns)
        except (OSError, sqlite3.Error) as error:
            raise self._ended_by(error, mark, lambda: self._append(topic, raw, time_ns)) from None
        except BaseException:
            self._undo(mark)
            raise
        self.flush_if_due()

    def flush_if_due(self) -> None:
        """Flush if the last time is `FLUSH_PERIOD` ago; for times when nothing is written.

        Raises
        ------
        ExperimentError
            As `write`.
        """
        if time.monotonic() - self._flushed >= FLUSH_PERIOD:
            self.flush()

    def flush(self) -> None:
        """Make all that was written safe from this process's death.

        Raises
        ------
        ExperimentError
            As `write`.
        """
        if self._error is not None:
            raise self._error
        if not self._open:
            return
        mark = self._storage.mark()
        try:
            self._storage.flush()
        except (OSError, sqlite3.Error) as error:
            raise self._ended_by(error, mark) from None
        self._flushed = time.monotonic()
        if self._reserve.is_last():  # sooner than a write fails, which may take others with it
            full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            raise self._ended_by(full, self._storage.mark())

    def close(self, custom_data: Mapping[str, str] | None = None) -> None:
        """Write index and metadata; does nothing if the bag is closed or broken.

        Parameters
        ----------
        custom_data : mapping of str to str, optional
            Kept in the bag's metadata.

        Raises
        ------
        ExperimentError
            As `write`.
        """
        if not self._open or self._error is not None:
            return
        self.flush()
        for key, value in (custom_data or {}).items():
            self._writer.set_custom_data(key, value)
        self._open = False
        self._reserve.release()
        try:
            self._writer.close()
        except (OSError, sqlite3.Error) as error:
            raise self._broken(error) from None
        except BaseException:
            self._writer.abort()
            raise

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

    def _undo(self, mark: Any) -> None:
        self._storage.undo(mark)
        known = {item.id for item in self._writer.connections}
        self._connections = {k: c for k, c in self._connections.items() if c.id in known}

    def _ended_by(
        self, error: Exception, mark: Any, again: Callable[[], None] = lambda: None
    ) -> ExperimentError:
        """Close the bag in the room that was kept, with the message that did not fit before."""
        self._reserve.release()
        try:
            self._undo(mark)
            again()
            self._storage.flush()
            self._writer.close()
        except (OSError, sqlite3.Error):
            return self._broken(error)
        self._open = False
        self._error = ExperimentError(
            f"{self.path}: the bag ends here ({_reason(error)}); what was recorded can be read. "
            "Make room before the next test"
        )
        return self._error

    def _broken(self, error: Exception) -> ExperimentError:
        with suppress(OSError, sqlite3.Error):
            self._writer.abort()
        self._error = ExperimentError(
            f"{self.path}: the bag can't be written on ({_reason(error)}); mend that, then get "
            f"back what was recorded with: seft recover {self.path}"
        )
        return self._error


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)
