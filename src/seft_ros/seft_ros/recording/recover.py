"""Make a whole bag of one whose recorder was killed."""

import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import zstandard
from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer
from seft_msgs_py.errors import InputError

from seft_ros.recording.bag_files import open_bag, storage_files, storage_suffix
from seft_ros.recording.bag_topics import add_source
from seft_ros.recording.salvage import Found, Source, mcap_messages, sqlite_messages


@dataclass(frozen=True)
class Recovery:
    """What `recover` did with the bag at ``path``; one that could be read was left as it was."""

    path: Path
    intact: bool
    messages: int  # in it now
    topics: dict[str, int]  # topic -> messages
    original: Path | None  # where the cut-off original is kept; None if intact

    def __str__(self) -> str:
        if self.intact:
            return f"{self.path} is intact ({self.messages} messages); nothing was done"
        return (
            f"{self.path} is whole again, with {self.messages} messages; the cut-off original "
            f"is kept as {self.original}"
        )


def recover(path: str | Path) -> Recovery:
    """Make a whole bag of a cut-off one, at the same path.

    The bag is written beside the original as ``<name>.recovering``; when it is complete the
    original becomes ``<name>.cut`` and the bag takes its place. If this is interrupted,
    nothing is lost, and calling it again goes on from there.

    Parameters
    ----------
    path : path
        A bag's folder, or a single mcap or sqlite3 file.

    Raises
    ------
    InputError
        If there is no bag, no whole message in it, ``<name>.cut`` is taken, or the disk
        refuses; the original is then as it was.
    """
    path = Path(path)
    place = path.resolve()
    cut, fresh = place.with_name(place.name + ".cut"), place.with_name(place.name + ".recovering")
    built = fresh / place.name
    try:
        if not place.exists() and cut.exists() and built.exists():
            built.rename(place)
            shutil.rmtree(fresh)
            return _summary(path, cut)
        if _is_intact(place, path):
            return _summary(path, None)
        if cut.exists():
            raise InputError(f"{cut} is in the way, from an earlier recovery; move it elsewhere")
        shutil.rmtree(fresh, ignore_errors=True)
        fresh.mkdir()
        try:
            _build(storage_files(place), fresh, built, path, single=place.is_file())
            place.rename(cut)
            try:
                built.rename(place)
            except BaseException:
                cut.rename(place)
                raise
        finally:
            if place.exists():
                shutil.rmtree(fresh, ignore_errors=True)
    except (OSError, sqlite3.Error) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: it can't be recovered ({reason}); it is as it was") from None
    return _summary(path, cut)


def _is_intact(place: Path, shown: Path) -> bool:
    if not place.exists():
        raise InputError(f"{shown}: there is no such bag")
    storage_files(place)  # no bag at all: says so
    try:
        open_bag(place).close()
    except InputError:
        return False
    return True


def _summary(path: Path, original: Path | None) -> Recovery:
    with closing(open_bag(path)) as reader:
        topics = {connection.topic: connection.msgcount for connection in reader.connections}
        shown = path.with_name(original.name) if original and path.name else original
        return Recovery(path, original is None, reader.message_count, topics, shown)


def _build(files: list[Path], fresh: Path, built: Path, shown: Path, single: bool) -> None:
    """Write the bag as ``built``, complete or not at all."""
    kinds = {storage_suffix(file) for file in files}
    if len(kinds) != 1:
        raise InputError(f"{shown}: mcap and sqlite3 files in one bag can't be recovered together")
    folder = fresh / "parts" / (built.stem if single else built.name)
    plugin = StoragePlugin.MCAP if kinds == {".mcap"} else StoragePlugin.SQLITE3
    with Writer(folder, version=9, storage_plugin=plugin) as writer:
        writer.set_custom_data("recovered", "true")
        connections: dict[Source, Connection] = {}
        for file in files:
            for source, time_ns, data in _messages(file, fresh):
                if source not in connections:
                    connections[source] = add_source(writer, source)
                writer.write(connections[source], time_ns, data)
        if not connections:
            raise InputError(f"{shown}: no whole message is in it; there is nothing to recover")
        whole = writer.storage.path if single and writer.storage else folder
    whole.rename(built)


def _messages(file: Path, scratch: Path) -> Iterator[Found]:
    if file.suffix == ".zstd":
        unpacked = scratch / file.stem
        with file.open("rb") as packed, unpacked.open("wb") as plain:
            for block in zstandard.ZstdDecompressor().read_to_iter(packed):
                plain.write(block)
        file = unpacked
    if file.suffix == ".mcap":
        return mcap_messages(file)
    copies = scratch / "sqlite"
    shutil.rmtree(copies, ignore_errors=True)
    copies.mkdir()
    for part in ("", "-journal", "-wal", "-shm"):
        if (source := file.with_name(file.name + part)).exists():
            shutil.copyfile(source, copies / source.name)
    return sqlite_messages(copies / file.name)
