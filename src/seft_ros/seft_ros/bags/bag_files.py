"""A bag on disk: open it, or say in one line why it can't be read; recover one that was cut off."""

import re
import shutil
import sqlite3
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path

from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from seft_msgs_py.errors import InputError

from seft_ros.bags.bag_storage import Connections, append, file_messages, file_reason

SUFFIXES = (".mcap", ".db3")
_MCAP_MAGIC = b"\x89MCAP0\r\n"


def open_bag(path: str | Path) -> Reader:
    """Open a bag: a folder with its metadata, or a single mcap or sqlite3 file.

    Returns
    -------
    Reader
        Open; to be closed by the caller.

    Raises
    ------
    InputError
        If there is nothing, or no bag, or one whose recording was cut off.
    """
    path = Path(path)
    files = storage_files(path)
    try:
        reader = Reader(path)
        reader.open()
        try:
            _check_metadata(reader)
        except Exception:
            reader.close()
            raise
    except Exception as error:  # rosbags' parsers raise what garbage makes them raise
        if isinstance(error, PermissionError):
            raise InputError(f"{path}: {error.strerror}") from None
        lacks_metadata = path.is_dir() and not (path / "metadata.yaml").exists()
        is_cut = lacks_metadata or any(is_cut_off(file) for file in files)
        reason = "its recording was cut off" if is_cut else file_reason(error)
        raise InputError(
            f"{path}: the bag can't be read: {reason}; recover what is in it with: "
            f"seft recover {path}"
        ) from None
    return reader


def _check_metadata(reader: Reader) -> None:
    """Refuse what rosbags takes from metadata.yaml unchecked."""
    for item in reader.connections:
        if not (isinstance(item.topic, str) and isinstance(item.msgtype, str)):
            raise TypeError(f"its metadata.yaml names a topic {item.topic!r} of {item.msgtype!r}")
        if not isinstance(item.msgcount, int):
            raise TypeError(f"its metadata.yaml counts {item.msgcount!r} messages")


def storage_files(path: str | Path) -> list[Path]:
    """List the files of a bag that hold messages, in the order in which they were written.

    Raises
    ------
    InputError
        If there is no such path, or no bag there.
    """
    path = Path(path)
    try:
        if path.is_dir():
            found = [file for file in path.iterdir() if storage_suffix(file) in SUFFIXES]
            if found or (path / "metadata.yaml").exists():
                return sorted(found, key=_natural_order)
            raise InputError(f"{path}: no bag: the folder has no mcap or db3 file")
        if not path.exists():
            raise InputError(f"{path}: there is no such bag")
    except OSError as error:
        raise InputError(f"{path}: {file_reason(error)}") from None
    if storage_suffix(path) not in SUFFIXES:
        raise InputError(f"{path}: not a bag; give a bag's folder, or an mcap or db3 file")
    return [path]


def storage_suffix(file: Path) -> str:
    """Give the suffix that names the format: ``.mcap`` of ``x.mcap`` and ``x.mcap.zstd``."""
    return file.with_suffix("").suffix if file.suffix == ".zstd" else file.suffix


def is_cut_off(file: Path) -> bool:
    """Tell whether a file is an mcap file that has the beginning of one but not the end."""
    if file.suffix != ".mcap":
        return False
    with file.open("rb") as stream:
        head = stream.read(len(_MCAP_MAGIC))
        stream.seek(max(len(head), file.stat().st_size - len(_MCAP_MAGIC)))
        return _MCAP_MAGIC.startswith(head) and stream.read() != _MCAP_MAGIC


def _natural_order(file: Path) -> list[tuple[int, str]]:
    """Sort bag_2 before bag_10."""
    parts = re.split(r"(\d+)", file.name)
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts]


@dataclass(frozen=True)
class Recovery:
    """What `recover` did with the bag at ``path``; an intact one was left unchanged."""

    path: Path
    intact: bool
    messages: int  # in it now
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
    nothing is lost, and another call continues.

    Parameters
    ----------
    path : path
        A bag's folder, or a single mcap or sqlite3 file.

    Raises
    ------
    InputError
        If there is no bag, no complete message in it, ``<name>.cut`` exists, or the disk
        fails; the original is then unchanged.
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
        files = storage_files(path)
        with suppress(InputError):
            open_bag(place).close()
            return _summary(path, None)
        if cut.exists():
            raise InputError(f"{cut} is in the way, from an earlier recovery; move it elsewhere")
        shutil.rmtree(fresh, ignore_errors=True)
        fresh.mkdir()
        try:
            _build(files, fresh, built, path, single=place.is_file())
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
        raise InputError(
            f"{path}: it can't be recovered ({file_reason(error)}); it is as it was"
        ) from None
    return _summary(path, cut)


def _summary(path: Path, original: Path | None) -> Recovery:
    with closing(open_bag(path)) as reader:
        return Recovery(path, original is None, reader.message_count, original)


def _build(files: list[Path], fresh: Path, built: Path, shown: Path, single: bool) -> None:
    """Write the bag as ``built``, complete or not at all."""
    kinds = {storage_suffix(file) for file in files}
    if len(kinds) != 1:
        raise InputError(f"{shown}: mcap and sqlite3 files in one bag can't be recovered together")
    folder = fresh / "parts" / (built.stem if single else built.name)
    plugin = StoragePlugin.MCAP if kinds == {".mcap"} else StoragePlugin.SQLITE3
    with Writer(folder, version=9, storage_plugin=plugin) as writer:
        writer.set_custom_data("recovered", "true")
        connections: Connections = {}
        for file in files:
            for found in file_messages(file, file.name, fresh):
                append(writer, connections, found)
        if not connections:
            raise InputError(f"{shown}: no whole message is in it; there is nothing to recover")
        whole = writer.storage.path if single and writer.storage else folder
    whole.rename(built)
