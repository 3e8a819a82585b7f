"""A bag on disk: open it, or say in one line why it can't be read."""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader
from seft_msgs_py.errors import InputError

from seft_ros.recording.bag_blocks import bag_blocks
from seft_ros.recording.message_block import MessageBlock

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
        reason = (str(error).splitlines() or [type(error).__name__])[0].rstrip(".")
        if isinstance(error, PermissionError):
            raise InputError(f"{path}: {error.strerror}") from None
        if any(is_cut_off(file) for file in files) or _lacks_metadata(path):
            reason = "its recording was cut off"
        raise InputError(
            f"{path}: the bag can't be read: {reason}; get back what is in it with: "
            f"seft recover {path}"
        ) from None
    return reader


def read_blocks(
    reader: Reader, connections: Sequence[Connection], path: str | Path
) -> Iterator[MessageBlock]:
    """Messages of some connections in the order of time, many at a time.

    Raises
    ------
    InputError
        If the bag is damaged inside.
    """
    blocks = bag_blocks(reader, connections)
    while True:
        try:
            block = next(blocks)
        except StopIteration:
            return
        except Exception as error:  # as above
            reason = (str(error).splitlines() or [type(error).__name__])[0].rstrip(".")
            raise InputError(
                f"{path}: the bag is damaged inside ({reason}); no message after that place "
                "can be read"
            ) from None
        yield block


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


def _lacks_metadata(path: Path) -> bool:
    return path.is_dir() and not (path / "metadata.yaml").exists()


def _natural_order(file: Path) -> list[tuple[int, str]]:
    """bag_2 before bag_10."""
    parts = re.split(r"(\d+)", file.name)
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts]
