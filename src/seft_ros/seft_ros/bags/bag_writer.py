"""Write a bag that survives its process, its disk and its folder.

What is received is in the file after at most a quarter of a second, in chunks with a checksum. What
the disk does not take stays in memory. A bag that was deleted, moved or can't be written any more
is saved under the first free name there, or among temporary files: its file can be read as long as
it is open.
"""

import os
import resource
import shutil
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from datetime import datetime
from functools import lru_cache
from io import BytesIO, StringIO
from itertools import chain, count
from pathlib import Path
from signal import raise_signal
from typing import IO, Any, Self, cast

from mcap.writer import CompressionType, Writer
from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos
from ruamel.yaml import YAML
from seft_msgs_py.config.parameter_table import Section
from seft_msgs_py.config.registered import reason_of
from seft_msgs_py.errors import ExperimentError, InputError
from seft_msgs_py.node.process import as_before, on_ending
from seft_msgs_py.wire.topics import Topic

from seft_ros.bags.mcap_file import MCAP_LIBRARY, RECOVERED, ROSBAG, BagSource, source_of
from seft_ros.bags.message_blocks import MAX_SIZE

METADATA = "metadata.yaml"
FLUSH_PERIOD = 0.25  # s of wall time
CHUNK = 1 << 16
"""Bytes of messages that are kept together: so many are lost with one wrong byte."""
RESERVED = 12 << 20
"""Bytes for the end of a test when the disk is full, and the index of a bag of hours."""
MAX_IN_MEMORY = 1 << 30  # bytes, of a test that goes on without its bag
SAVED = "_saved"
"""Added to the name of a bag whose own is taken."""
_HANDLES = Path("/proc/self/fd")
_COPIED = 1 << 24  # bytes at a time


class _Unstored:
    """The end of a file that is not on the disk yet; `mcap` writes here."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.stored = 0  # bytes before it

    def write(self, data: bytes) -> None:
        self.data += data

    def tell(self) -> int:
        return self.stored + len(self.data)

    def flush(self) -> None:
        """`BagWriter` stores the data when it wants."""


class BagWriter:
    """A rosbag2 bag (version 9, mcap) that is being written.

    In a ``with`` statement the bag has to be in its place: if it can't be made there, that is an
    InputError at the beginning; if it can't be written, an ExperimentError at the end. Without,
    `trouble` says so, messages are kept in memory, and `save` finds a place.

    Only SIGKILL or a disk that fails leave a bag without an end, which
    `seft_ros.bags.bag_files.Bag` reads all the same.

    Parameters
    ----------
    path : path
        Folder to be made for the bag.
    damage : sequence of str
        What is missing from the bag, if it is a recovered one.

    Attributes
    ----------
    path : Path
        The bag's folder.
    trouble : str
        What is wrong with its place: that it can't be made or written, was lost or cut off, or that
        the disk is full; empty if nothing is.
    """

    def __init__(self, path: str | Path, damage: Sequence[str] = ()) -> None:
        self.path = Path(path)
        self.trouble = ""
        self._pending: list[tuple[BagSource, int, bytes]] = []
        self._size = 0  # of these, bytes
        self._out = _Unstored()
        self._writer = Writer(
            cast("IO[bytes]", self._out),
            chunk_size=MAX_SIZE,  # a chunk ends at each flush
            compression=CompressionType.NONE,
            enable_data_crcs=True,
        )
        self._writer.start("ros2", MCAP_LIBRARY)
        if damage:
            self._writer.add_metadata(RECOVERED, {"damage": "\n".join(damage)})
        self._channels: dict[BagSource, int] = {}
        self._types: dict[str, int] = {}
        self._counts: Counter[int] = Counter()  # messages of each channel
        self._first, self._last = 2**63 - 1, 0  # log times
        self._metadata = ""  # of the complete bag
        self._is_saved = False
        self._cut_off = ""  # what another program has done to the file
        self._file: IO[bytes] | None = None
        self._reserve: IO[bytes] = BytesIO()  # frees its room when it is closed, or we are killed
        self._flushed_at = time.monotonic()
        self._make_place()

    @property
    def is_full(self) -> bool:
        """Whether messages that the disk does not take have used up the memory for them."""
        return len(self._out.data) + self._size > MAX_IN_MEMORY

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
        """
        self.add(source_of(topic), time_ns, raw)

    def add(self, source: BagSource, time_ns: int, raw: bytes) -> None:
        """Append a message as another bag had it; a complete bag takes none any more."""
        if self._metadata:
            return
        self._pending.append((source, time_ns, raw))
        self._size += len(raw)
        if self._size >= CHUNK:
            self._write_chunk()
        self.flush_if_due()

    def flush_if_due(self) -> None:
        """Flush if `FLUSH_PERIOD` has passed; to be called also when nothing is written."""
        if time.monotonic() - self._flushed_at >= FLUSH_PERIOD:
            self.flush()

    def flush(self) -> None:
        """Make all messages so far survive this process, as far as the disk takes them."""
        if self._metadata:
            return
        self._write_chunk()
        self._flushed_at = time.monotonic()
        self.trouble = self.trouble or self._displaced()

    def close(self) -> None:
        """Complete the bag in its place.

        Raises
        ------
        ExperimentError
            If that can't be done. To be called again when it may; until then what is on the disk
            can be read.
        """
        if self._is_saved:
            return
        with _uninterrupted():
            self._complete()
            self._reserve.close()
            self._store()
            why = self._displaced()
            if not why and (self._out.data or self._file is None):
                why = self.trouble
            try:
                if not why:
                    _write_metadata(self.path, self._metadata)
            except OSError as error:
                why = f"{self.path}: {file_reason(error)}"
            if why:
                is_left = self._file is not None and os.fstat(self._file.fileno()).st_nlink
                left = "; the bag lacks its end, and can be read as it is" if is_left else ""
                raise ExperimentError(f"{why}{left}")
            self._done()
        if self._cut_off:
            raise ExperimentError(f"{self._cut_off}; the remainder of the bag can be read")

    def save(self) -> Path:
        """Complete the bag, in another place if need be; give its folder.

        Raises
        ------
        ExperimentError
            If there is no place for it, here or in the folder for temporary files; to be called
            again when there may be one.
        """
        with suppress(ExperimentError):
            self.close()
        if self._is_saved:
            return self.path
        faults = []
        for folder in (self.path.parent, Path(tempfile.gettempdir())):
            place = free_place(folder, self.path.name, f"{self.path.name}{SAVED}")
            try:
                self._copy_to(place)
            except OSError as error:
                faults.append(f"{place}: {file_reason(error)}")
            else:
                self._done()
                return place
        raise ExperimentError(f"the bag can't be saved: {faults[0]}")

    def __enter__(self) -> Self:
        if self._file is None:
            raise InputError(f"{self.trouble}; name another folder with --out")
        return self

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        try:
            self.close()
        except ExperimentError:
            if error is None:  # else the reason for leaving counts
                raise
        finally:
            self._done()

    def _make_place(self) -> None:
        try:
            self.path.mkdir(mode=0o755, parents=True)
            self._reserve = tempfile.TemporaryFile(dir=self.path)  # noqa: SIM115
            os.posix_fallocate(self._reserve.fileno(), 0, RESERVED)
            self._file = _storage_file(self.path).open("x+b", buffering=0)
        except FileExistsError:
            self.trouble = f"{self.path} exists already"
        except OSError as error:
            self._reserve.close()
            with suppress(OSError):
                self.path.rmdir()
            self.trouble = f"{self.path}: no bag can be made there ({file_reason(error)})"

    def _write_chunk(self) -> None:
        with _uninterrupted():
            self._encode()
            self._store()

    def _encode(self) -> None:
        """Make a chunk of the messages so far."""
        for source, time_ns, raw in self._pending:
            channel = self._channels.get(source)
            if channel is None:
                channel = self._channels[source] = self._new_channel(source)
            self._writer.add_message(channel, time_ns, raw, time_ns)
            self._counts[channel] += 1
            self._first, self._last = min(self._first, time_ns), max(self._last, time_ns)
        self._pending, self._size = [], 0
        self._writer.flush()  # type: ignore[no-untyped-call]

    def _new_channel(self, source: BagSource) -> int:
        """Add a topic, of whatever type."""
        if (kind := source.type) not in self._types:
            definition = source.encoding, source.definition.encode()
            self._types[kind] = self._writer.register_schema(kind, *definition)
        qos, digest = _yaml(_qos_of(source.qos)), source.digest()
        metadata = {"offered_qos_profiles": qos, "topic_type_hash": digest}
        known = source.topic, source.serialization, self._types[kind]
        return self._writer.register_channel(*known, metadata)

    def _complete(self) -> None:
        """Add the index."""
        if self._metadata:
            return
        self._encode()
        file = _storage_file(self.path).name
        counts = {source: self._counts[channel] for source, channel in self._channels.items()}
        self._metadata = _metadata(file, counts, self._first, self._last)
        self._writer.add_metadata(ROSBAG, {"serialized_metadata": self._metadata})
        self._writer.finish()  # type: ignore[no-untyped-call]

    def _store(self) -> None:
        """Write to the disk; if it is full, into the room that was reserved."""
        if self._file is not None and not self._cut_off:
            size = os.fstat(self._file.fileno()).st_size
            if size < self._out.stored:  # writing goes on behind the gap
                lost = self._out.stored - size
                self._cut_off = f"{self.path}: its file was cut off, and {lost} bytes are lost"
                self.trouble = self.trouble or self._cut_off
        while self._file is not None and self._out.data:
            try:
                written = os.pwrite(self._file.fileno(), self._out.data[:_COPIED], self._out.stored)
                self._out.stored += written
                del self._out.data[:written]
            except OSError as error:
                self.trouble = self.trouble or f"{self.path}: {file_reason(error)}"
                if self._reserve.closed:
                    return
                self._reserve.close()

    def _displaced(self) -> str:
        """Say whether the bag was deleted or moved; empty if it is in its place."""
        if self._file is None:
            return ""
        status = os.fstat(self._file.fileno())
        with suppress(OSError):
            if os.path.samestat(_storage_file(self.path).stat(), status):
                return ""
        place = (_HANDLES / str(self._file.fileno())).readlink()
        what = f"moved: its file is {place}" if status.st_nlink else "deleted"
        return f"{self.path}: the bag was {what}"

    def _copy_to(self, place: Path) -> None:
        """Copy what is on the disk, and add what is not; leave nothing if that fails."""
        place.mkdir(mode=0o755, parents=True)
        try:
            with (place / _storage_file(self.path).name).open("xb") as copy:
                for at in range(0, self._out.stored, _COPIED):
                    size = min(_COPIED, self._out.stored - at)
                    assert self._file is not None
                    copy.write(os.pread(self._file.fileno(), size, at))
                copy.write(self._out.data)
            _write_metadata(place, self._metadata)
        except BaseException:
            shutil.rmtree(place, ignore_errors=True)
            raise

    def _done(self) -> None:
        self._is_saved = True
        if self._file is not None:
            self._file.close()


def file_reason(error: Exception) -> str:
    """Say in one line why a file can't be read or written."""
    return (getattr(error, "strerror", None) or reason_of(error)).splitlines()[0].rstrip(".")


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Let a signal that ends this process wait: after half a record no other can be read."""
    if threading.current_thread() is not threading.main_thread():
        yield  # signals are handled elsewhere
        return
    came: list[int] = []
    before = on_ending(lambda number, _: came.append(number))
    try:
        yield
    finally:
        as_before(before)
    for number in came[:1]:
        raise_signal(number)


def _storage_file(folder: Path) -> Path:
    return folder / f"{folder.name}.mcap"


def _yaml(tree: Any) -> str:
    yaml, text = YAML(typ="safe"), StringIO()
    yaml.default_flow_style = False
    yaml.representer.ignore_aliases = lambda *_: True
    yaml.dump(tree, text)
    return text.getvalue().strip()


@lru_cache
def _qos_of(offered: str) -> list[Any]:
    with suppress(Exception):  # what another recorder wrote, and nobody here needs
        return list(dump_qos_v9(parse_qos(offered)))
    return []


def _metadata(file: str, counts: Mapping[BagSource, int], first: int, last: int) -> str:
    """Give the text of metadata.yaml."""
    times = {
        "starting_time": {"nanoseconds_since_epoch": first},
        "duration": {"nanoseconds": max(0, last - first)},
        "message_count": sum(counts.values()),
    }
    topics = [
        {
            "topic_metadata": {
                "name": source.topic,
                "type": source.type,
                "serialization_format": source.serialization,
                "offered_qos_profiles": _qos_of(source.qos),
                "type_description_hash": source.digest(),
            },
            "message_count": number,
        }
        for source, number in counts.items()
    ]
    tree = {
        "version": 9,
        "storage_identifier": "mcap",
        "relative_file_paths": [file],
        **times,
        "topics_with_message_count": topics,
        "compression_format": "",
        "compression_mode": "",
        "files": [{"path": file, **times}],
        "custom_data": None,
        "ros_distro": "jazzy",
    }
    return _yaml({"rosbag2_bagfile_information": tree})


def _write_metadata(folder: Path, text: str) -> None:
    """Write metadata.yaml: whole or not at all."""
    part = folder / f"{METADATA}.part"
    part.write_text(text, encoding="utf-8")
    part.replace(folder / METADATA)


def free_place(folder: Path, *names: str) -> Path:
    """Give the first of some names in a folder that is free, or else the last with a number."""
    numbered = (f"{names[-1]}_{k}" for k in count(2))
    return next(p for name in chain(names, numbered) if not (p := folder / name).exists())


def bag_place(section: Section) -> Path:
    """Folder of the next bag, by the recorder's section; a default name is a free one."""
    directory, name = Path(section["directory"]), section["name"]
    by_time = datetime.now().strftime("seft_%Y-%m-%d_%H-%M-%S")
    return directory / name if name else free_place(directory, by_time)


_LEFT = 4 << 20  # bytes that must stay free beside the bag, for other files of a test
_FILES = 8  # that can be made: the bag's folder, its files, and those of the test


def why_not_writable(place: Path) -> str:
    """Say why no bag can be made in a folder that is to be made; empty if it can."""
    folder = place.absolute().parent
    while not os.path.lexists(folder) and folder != folder.parent:
        folder = folder.parent
    needed = RESERVED + _LEFT
    largest, _ = resource.getrlimit(resource.RLIMIT_FSIZE)
    if largest != resource.RLIM_INFINITY and largest < needed:
        may = f"{largest / 1e6:.0f} MB by a limit of this process (ulimit -f)"
        return f"a file may have {may}, and the bag needs {needed / 1e6:.0f} MB"
    try:
        with suppress(FileNotFoundError, NotADirectoryError):
            place.lstat()
            return f"{place} exists already"
        with ExitStack() as files:  # without names
            for _ in range(_FILES):
                file = files.enter_context(tempfile.TemporaryFile(dir=folder))
            free = shutil.disk_usage(file.fileno()).free
            if free >= needed:
                os.posix_fallocate(file.fileno(), 0, RESERVED)  # also a quota may be used up
    except OSError as error:
        return f"nothing can be written in {folder} ({file_reason(error)})"
    if free < needed:
        return f"{folder} has room for {free / 1e6:.0f} MB, and the bag needs {needed / 1e6:.0f} MB"
    return ""
