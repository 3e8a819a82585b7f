"""An mcap file of ours that is read as far as it is right; what is not is left out and named.

The file is read from its beginning, without the index at its end. A chunk of messages counts as a
whole: with its checksum, its sizes and its end, or not at all. Behind damage, reading continues at
the next chunk. Files of other programs are read by `seft_ros.bags.foreign_file`.
"""

import re
import struct
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import lru_cache
from io import BytesIO
from typing import IO, NamedTuple

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, Footer, Header, Metadata, Schema, Statistics
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from seft_msgs_py.wire.messages import typestore
from seft_msgs_py.wire.topics import Topic

from seft_ros.bags.message_blocks import MAX_SIZE, DamageError, MessageBlock, records_of

_QOS = """
- history: keep_last
  depth: {depth}
  reliability: reliable
  durability: {durability}
  deadline: &forever {{sec: 9223372036, nsec: 854775807}}
  lifespan: *forever
  liveliness: automatic
  liveliness_lease_duration: *forever
  avoid_ros_namespace_conventions: false
"""
_UNKNOWN_HASH = "RIHS01_" + "0" * 64


class BagSource(NamedTuple):
    """A topic as a bag's file describes it."""

    topic: str  # with leading slash
    type: str
    definition: str = ""  # text that defines the type
    encoding: str = "ros2msg"  # of the definition
    serialization: str = "cdr"
    qos: str = ""  # offered, YAML

    def digest(self) -> str:
        """Give the hash of the type, by which ROS 2 tells definitions apart; zeros if unknown."""
        if self.type in typestore().fielddefs:
            return typestore().hash_rihs01(self.type)
        store = get_typestore(Stores.EMPTY)
        with suppress(Exception):  # the definition is foreign text, and its hash dispensable
            store.register(get_types_from_msg(self.definition, self.type))
            return store.hash_rihs01(self.type)
        return _UNKNOWN_HASH


@lru_cache
def source_of(topic: Topic) -> BagSource:
    """Describe a topic of a test, with the quality of service of its publisher."""
    definition, _ = typestore().generate_msgdef(topic.type, ros_version=2)
    durability = "transient_local" if topic.latched else "volatile"
    qos = _QOS.format(depth=topic.depth, durability=durability)
    return BagSource("/" + topic.name.lstrip("/"), topic.type, definition, qos=qos)


MCAP_LIBRARY = "seft"
"""The library that a file with all checksums names."""
RECOVERED = "seft_recovered"
"""Metadata of a recovered bag: ``damage`` has a line for each thing that it lacks."""
ROSBAG = "rosbag2"
"""Metadata that have the text of metadata.yaml, as ``serialized_metadata``."""
BATCH = 1 << 20
"""Bytes of chunks that are given together: enough for arrays to pay, few for the cache."""

MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")  # of a record: opcode, length
_PRIVATE = 0x80  # the first of the opcodes that anybody may use
_WINDOW = 1 << 16  # bytes that are searched at a time
_RESUMED = re.compile(rb"\x06.{36}\0\0\0\0|\x0f\x04\0{7}", re.DOTALL)
"""Where reading may continue: the head of a chunk, or the end of all messages."""
_GARBAGE = (McapError, struct.error, ValueError, OverflowError, MemoryError)
"""What parsers raise for garbage."""


class _Part(NamedTuple):
    """A chunk in the file: place and size of its record's content, messages by their source."""

    start: int
    size: int
    counts: Mapping[int, int]


class McapFile:
    """An mcap file, checked when it is opened.

    Parameters
    ----------
    file : IO of bytes
        The open file.

    Attributes
    ----------
    sources : dict
        Number -> `BagSource`, of the topics in it.
    counts : Counter
        Number of a source -> number of messages that can be read.
    claimed : dict or None
        The same as the file itself says; None if it does not.
    damage : list of str
        What is wrong with it.
    checked : bool
        Whether all messages have a checksum, so that damaged ones are noticed: they have.
    recovered : list of str
        What is missing from a recovered bag.
    metadata : str
        Text of the bag's metadata.yaml, if the file is ours; else empty.
    """

    checked = True

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._size = file.seek(0, 2)
        self.sources: dict[int, BagSource] = {}
        self.claimed: dict[int, int] | None = None
        self.recovered: list[str] = []
        self.metadata = ""
        self._schemas: dict[int, Schema] = {}
        self._bad: dict[str, list[int]] = {}  # what -> where
        self._ours = False
        self._parts: list[_Part] = []
        self._walk()
        every = sum((Counter(part.counts) for part in self._parts), Counter[int]())
        self.counts = Counter({number: every[number] for number in self.sources})
        self.damage = [
            f"{what} (at byte {where[0]}"
            + (f" and {len(where) - 1} more places)" if where[1:] else ")")
            for what, where in self._bad.items()
        ]
        if lost := every.total() - self.counts.total():
            self.damage.append(f"of {lost} messages the topic is lost")

    def blocks(self, numbers: Mapping[int, int]) -> Iterator[MessageBlock]:
        """Give the messages of some sources; ``numbers`` are what blocks have as their sources."""
        table = np.full(1 << 16, -1, np.int64)
        table[list(numbers)] = list(numbers.values())
        blocks: list[MessageBlock] = []
        for part in self._parts:
            if not part.counts.keys().isdisjoint(numbers):
                chunk = Chunk.read(self._body(part.start, part.size))
                blocks.append(records_of(_checked(chunk))[0].renumbered(table))
            if sum(len(block.data) for block in blocks) >= BATCH:
                yield MessageBlock.joined(blocks)
                blocks = []
        if blocks:
            yield MessageBlock.joined(blocks)

    def _walk(self) -> None:
        """Go from record to record, and behind damage to the next chunk."""
        at: int | None = len(MAGIC)
        is_lost = self._read(0, len(MAGIC)) != MAGIC
        if is_lost:
            self._note("it does not begin as an mcap file" if self._size else "it is empty", 0)
            at = self._next(0)
        while (place := at) is not None:
            try:
                at, is_lost = self._take(place), False
            except _GARBAGE as error:
                if not is_lost:
                    known = isinstance(error, DamageError)
                    self._note(str(error) if known else "a record is damaged", place)
                at, is_lost = self._next(place + 1), True

    def _take(self, at: int) -> int | None:
        """Take a record; give the place of the next one, None at the end of the file.

        Raises one of `_GARBAGE` if it is damaged.
        """
        start = at + _HEAD.size
        if start > self._size:
            raise DamageError("it is cut off")
        opcode, size = _HEAD.unpack(self._read(at, _HEAD.size))
        if size > self._size - start:
            raise DamageError("it is cut off, or a record is damaged")
        body, end = self._body(start, size), start + size
        match opcode:
            case Opcode.CHUNK:
                chunk = Chunk.read(body)
                if body.count != size:
                    raise DamageError("a record is damaged")
                self._add(chunk, start, size)
            case Opcode.HEADER:
                self._ours = Header.read(body).library.startswith(MCAP_LIBRARY)
            case Opcode.METADATA:
                record = Metadata.read(body)
                if record.name == RECOVERED:
                    self.recovered = record.metadata.get("damage", "").splitlines()
                elif record.name == ROSBAG and self._ours:
                    self.metadata = record.metadata.get("serialized_metadata", "")
            case Opcode.DATA_END:
                self._check(at, DataEnd.read(body).data_section_crc, 0, at)
            case Opcode.FOOTER:
                footer = Footer.read(body)
                summary = footer.summary_start or at
                if self._check(at, footer.summary_crc, summary, end - 4):
                    self._define(self._read(summary, at - summary))
                if self._read(end, self._size - end) != MAGIC:
                    raise DamageError("its end is not that of an mcap file")
                return None
            case _ if not Opcode.HEADER <= opcode <= Opcode.DATA_END and opcode < _PRIVATE:
                raise DamageError("a record is damaged")
        return end

    def _check(self, at: int, checksum: int, start: int, end: int) -> bool:
        """Check a part of the file by the checksum in a record at a place."""
        if not (checksum or self._ours):
            return True
        found = 0
        for place in range(start, end, _WINDOW):
            found = zlib.crc32(self._read(place, min(_WINDOW, end - place)), found)
        if found != checksum and not self._bad:
            self._note("what stands beside the messages fails its checksum", at)
        return found == checksum

    def _add(self, chunk: Chunk, start: int, size: int) -> None:
        """Add a chunk of messages, if it is right."""
        block = self._define(_checked(chunk))
        numbers, counts = np.unique(block.places["source"], return_counts=True)
        counted = dict(zip(numbers.tolist(), counts.tolist(), strict=True))
        self._parts.append(_Part(start, size, counted))

    def _define(self, raw: bytes) -> MessageBlock:
        """Take the types, channels and counts among some records; give the messages."""
        block, others = records_of(raw)
        for opcode, content in others:
            body = ReadDataStream(BytesIO(content))
            if opcode == Opcode.STATISTICS:
                self.claimed = dict(Statistics.read(body).channel_message_counts)
            elif opcode == Opcode.SCHEMA:
                schema = Schema.read(body)
                self._schemas[schema.id] = schema
            elif (channel := Channel.read(body)).schema_id in self._schemas:
                schema = self._schemas[channel.schema_id]
                definition = schema.data.decode(errors="replace"), schema.encoding
                more = channel.message_encoding, channel.metadata.get("offered_qos_profiles", "")
                found = BagSource(channel.topic, schema.name, *definition, *more)
                self.sources.setdefault(channel.id, found)
        return block

    def _note(self, what: str, at: int) -> None:
        self._bad.setdefault(what, []).append(at)

    def _body(self, start: int, size: int) -> ReadDataStream:
        return ReadDataStream(BytesIO(self._read(start, size)))

    def _read(self, at: int, size: int) -> bytes:
        if not 0 <= size <= MAX_SIZE:
            raise DamageError("a record is damaged")
        self._file.seek(at)
        return self._file.read(size)

    def _next(self, place: int) -> int | None:
        """Find the next record from a place on at which reading may continue."""
        for start in range(place, self._size, _WINDOW):
            if found := _RESUMED.search(self._read(start, _WINDOW + 64)):
                return start + found.start()
        return None


def _checked(chunk: Chunk) -> bytes:
    """Give the records of a chunk, which is not compressed, and check it."""
    if len(chunk.data) != chunk.uncompressed_size:
        raise DamageError("a chunk of messages has another size than it declares")
    if not chunk.uncompressed_crc:
        raise DamageError("a chunk of messages has lost its checksum")
    if zlib.crc32(chunk.data) != chunk.uncompressed_crc:
        raise DamageError("a chunk of messages fails its checksum")
    return chunk.data


def is_foreign(file: IO[bytes]) -> bool:
    """Whether the head of an mcap file says that another program wrote it."""
    file.seek(0)
    with suppress(*_GARBAGE):
        if file.read(len(MAGIC)) == MAGIC:
            opcode, size = _HEAD.unpack(file.read(_HEAD.size))
            header = Header.read(ReadDataStream(BytesIO(file.read(min(size, _WINDOW)))))
            return opcode == Opcode.HEADER and not header.library.startswith(MCAP_LIBRARY)
    return False
