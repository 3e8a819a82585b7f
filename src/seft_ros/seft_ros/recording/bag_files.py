"""A bag on disk: open it, or say in one line why it can't be read."""

import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import batched
from pathlib import Path
from typing import Any

import zstandard
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader
from seft_msgs_py.errors import InputError

from seft_ros.recording.chunk_reader import read_chunks
from seft_ros.recording.message_block import MessageBlock

SUFFIXES = (".mcap", ".db3")
_MCAP_MAGIC = b"\x89MCAP0\r\n"
_ROWS = 2048  # messages that are joined to a block


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
        reason = _reason(error)
        if isinstance(error, PermissionError):
            raise InputError(f"{path}: {error.strerror}") from None
        lacks_metadata = path.is_dir() and not (path / "metadata.yaml").exists()
        if any(is_cut_off(file) for file in files) or lacks_metadata:
            reason = "its recording was cut off"
        raise InputError(
            f"{path}: the bag can't be read: {reason}; get back what is in it with: "
            f"seft recover {path}"
        ) from None
    return reader


def read_blocks(
    reader: Reader, connections: Sequence[Connection], path: str | Path
) -> Iterator[MessageBlock]:
    """Messages of some connections, file by file, each in the order of time, many at a time.

    A file's topics are known by name and type. rosbags looks at the quality of service too, and
    leaves out, without a word, topics of which metadata and file tell different things.

    Raises
    ------
    InputError
        If the bag is damaged inside.
    """
    numbers = {(item.topic, item.msgtype): k for k, item in reversed([*enumerate(connections)])}
    try:
        for storage in getattr(reader.storage, "storages", [reader.storage]):
            sources = {
                item.id: numbers[item.topic, item.msgtype]
                for item in storage.connections
                if (item.topic, item.msgtype) in numbers
            }
            if sources:
                packed = reader.compression_mode == "message"
                yield from _storage_blocks(storage, sources, packed)
    except Exception as error:  # as above
        raise InputError(
            f"{path}: the bag is damaged inside ({_reason(error)}); no message after that place "
            "can be read"
        ) from None


def _storage_blocks(storage: Any, sources: dict[int, int], packed: bool) -> Iterator[MessageBlock]:
    rows: Iterable[tuple[int, int, bytes]]  # connection, log time in ns, message
    if isinstance(storage, McapReader) and storage.chunks and not packed:
        yield from read_chunks(storage, sources)
        return
    if isinstance(storage, Sqlite3Reader) and not packed:
        assert storage.dbconn  # each row an object of its own only here
        marks = ",".join("?" * len(sources))
        rows = storage.dbconn.execute(
            "SELECT topic_id, timestamp, data FROM messages "
            f"WHERE topic_id IN ({marks}) ORDER BY timestamp",
            tuple(sources),
        )
    else:
        wanted = [item for item in storage.connections if item.id in sources]
        rows = (
            (item.id, time, _unpacked(raw) if packed else raw)
            for item, time, raw in storage.messages(wanted)
        )
    for some in batched(rows, _ROWS):
        items, times, raws = zip(*some, strict=True)
        yield MessageBlock.of(times, [sources[item] for item in items], raws)


def _unpacked(raw: bytes) -> bytes:
    """Message that the recorder packed; its frame need not tell the size."""
    unpacking = zstandard.ZstdDecompressor().decompressobj()
    message: bytes = unpacking.decompress(raw)
    if not unpacking.eof:
        raise zstandard.ZstdError("a packed message ends early")
    return message


def storage_files(path: str | Path) -> list[Path]:
    """Files of a bag that hold messages, in the order in which they were written.

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
            raise InputError(f"{path}: no bag, for no mcap or db3 file is in that folder")
        if not path.exists():
            raise InputError(f"{path}: there is no such bag")
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from None
    if storage_suffix(path) not in SUFFIXES:
        raise InputError(f"{path}: no bag; give a bag's folder, or an mcap or db3 file")
    return [path]


def storage_suffix(file: Path) -> str:
    """Suffix that tells the format of a file: ``.mcap`` of ``x.mcap`` and ``x.mcap.zstd``."""
    return file.with_suffix("").suffix if file.suffix == ".zstd" else file.suffix


def is_cut_off(file: Path) -> bool:
    """Whether a file is an mcap that begins as such and does not end as such."""
    if file.suffix != ".mcap":
        return False
    with file.open("rb") as stream:
        head = stream.read(len(_MCAP_MAGIC))
        size = stream.seek(0, 2)
        if head != _MCAP_MAGIC[: len(head)]:
            return False
        stream.seek(max(0, size - len(_MCAP_MAGIC)))
        return stream.read() != _MCAP_MAGIC or size == len(_MCAP_MAGIC)


def _check_metadata(reader: Reader) -> None:
    """Refuse what rosbags takes over from metadata.yaml without a look."""
    for item in reader.connections:
        if not (isinstance(item.topic, str) and isinstance(item.msgtype, str)):
            raise TypeError(f"its metadata.yaml names a topic {item.topic!r} of {item.msgtype!r}")
        if not isinstance(item.msgcount, int):
            raise TypeError(f"its metadata.yaml counts {item.msgcount!r} messages")


def _reason(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0].rstrip(".")


def _natural_order(file: Path) -> list[tuple[int, str]]:
    """bag_2 before bag_10."""
    parts = re.split(r"(\d+)", file.name)
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts]
