"""An mcap file that is read as far as it is right; what is not is left out and named.

The file is read from its beginning, without the index at its end. A chunk of messages counts as a
whole: with its checksum, its sizes and its end, or not at all. Behind damage, reading continues at
the next chunk.
"""

import re
import struct
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping
from io import BytesIO
from typing import IO, NamedTuple

import numpy as np
import zstandard
from lz4.frame import LZ4FrameDecompressor
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Footer, Header, Metadata, Schema, Statistics

from seft_ros.bags.message_blocks import (
    MAX_SIZE,
    DamageError,
    MessageBlock,
    inflated,
    records_of,
    unpacked,
)
from seft_ros.bags.source import BagSource

MCAP_LIBRARY = "seft"
"""The library that a file with all checksums names."""
RECOVERED = "seft_recovered"
"""Metadata of a recovered bag: ``damage`` has a line for each thing that it lacks."""
ROSBAG = "rosbag2"
"""Metadata that have the text of metadata.yaml, as ``serialized_metadata``."""
BATCH = 1 << 20
"""Bytes of chunks that are given together: enough for arrays to pay, few for the cache."""

_MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")  # of a record: opcode, length
_CHUNK = struct.Struct("<16xQII")  # size unpacked, checksum, length of the next text
_FOOTER = _HEAD.size + 20  # bytes
_LOOSE = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)
_OF_SUMMARY = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS)
_PRIVATE = 0x80  # the first of the opcodes that anybody may use
_WINDOW = 1 << 22  # bytes that are searched at a time
_RESUMED = re.compile(
    rb"(?=\x06.{36}(?:\0\0\0\0|\x04\0\0\0zstd|\x03\0\0\0lz4)|\x0f\x04\0{7})", re.DOTALL
)
"""Where reading may continue: the head of a chunk, or the end of all messages."""
_GARBAGE = (McapError, struct.error, ValueError, RuntimeError, MemoryError, zstandard.ZstdError)
"""What parsers raise for garbage; RuntimeError is lz4's."""


class _Chunk(NamedTuple):
    start: int  # of its data in the file
    size: int  # of these, bytes
    unpacked: int  # bytes
    compression: str = ""
    checksum: int = 0  # 0: none
    counts: Mapping[int, int] = {}  # messages, by number of their source


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
        Whether all messages have a checksum, so that damaged ones are noticed.
    recovered : list of str
        What is missing from a recovered bag.
    metadata : str
        Text of the bag's metadata.yaml, if the file is ours; else empty.
    """

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._size = file.seek(0, 2)
        self.sources: dict[int, BagSource] = {}
        self.claimed: dict[int, int] | None = None
        self.recovered: list[str] = []
        self.metadata = ""
        self._schemas: dict[int, Schema] = {}
        self._bad: dict[str, dict[int, None]] = {}  # what -> where
        self._ours = False
        self._summary: tuple[int, list[tuple[int, ReadDataStream]]] | None = None
        self._chunks: list[_Chunk] = []
        self._resume = 0  # where a chunk may begin that was not seen yet
        self._walk()
        self.checked = self._require_checksums()
        every = sum((Counter(chunk.counts) for chunk in self._chunks), Counter[int]())
        self.counts = Counter({number: every[number] for number in self.sources})
        self.damage = [
            f"{what} (at byte {next(iter(where))}"
            + (f" and {len(where) - 1} more places)" if len(where) > 1 else ")")
            for what, where in self._bad.items()
        ]
        if lost := every.total() - self.counts.total():
            self.damage.append(f"of {lost} messages the topic is lost")

    def blocks(self, numbers: Mapping[int, int]) -> Iterator[MessageBlock]:
        """Give the messages of some sources; ``numbers`` are what blocks have as their sources."""
        table = np.full(1 << 16, -1, np.int64)
        table[list(numbers)] = list(numbers.values())
        parts: list[MessageBlock] = []
        for chunk in self._chunks:
            if not chunk.counts.keys().isdisjoint(numbers):
                found = unpacked(records_of(self._data(chunk)).block)
                parts.append(found.renumbered(table))
            if sum(len(part.data) for part in parts) >= BATCH:
                yield MessageBlock.joined(parts)
                parts = []
        if parts:
            yield MessageBlock.joined(parts)

    def _walk(self) -> None:
        """Go from record to record, and behind damage to the next chunk."""
        following: int | None = len(_MAGIC)
        if self._read(0, len(_MAGIC)) != _MAGIC:
            self._note("it does not begin as an mcap file" if self._size else "it is empty", 0)
            following = self._next()
        while (at := following) is not None:
            try:
                following = self._take(at)
            except _GARBAGE as error:
                known = isinstance(error, DamageError)
                self._note(str(error) if known else "a record is damaged", at)
                following = self._next()

    def _take(self, at: int) -> int | None:
        """Take a record; give the place of the next one, None at the end of the file.

        Raises one of `_GARBAGE` if it is damaged.
        """
        opcode, start, end = self._span(at)
        if opcode == Opcode.CHUNK:
            chunk = self._chunk(at)
            self._resume, self._summary = end, None
            self._add(chunk)
        elif self._summary is not None and opcode in _OF_SUMMARY:
            self._summary[1].append((opcode, self._body(start, end)))
        elif opcode in _LOOSE:
            end = self._end_of_loose(at)
            self._add(_Chunk(at, end - at, end - at))
        elif opcode == Opcode.HEADER:
            self._ours = Header.read(self._body(start, end)).library.startswith(MCAP_LIBRARY)
        elif opcode == Opcode.METADATA:
            self._take_metadata(Metadata.read(self._body(start, end)))
        elif opcode == Opcode.DATA_END:
            self._resume, self._summary = end, (end, [])
            self._check(at, self._body(start, end).read4(), 0, at)
        elif opcode == Opcode.FOOTER:
            self._take_summary(Footer.read(self._body(start, end)), end - 4)
            if self._read(end, self._size - end) != _MAGIC:
                raise DamageError("its end is not that of an mcap file")
            return None
        elif not Opcode.HEADER <= opcode <= Opcode.DATA_END and opcode < _PRIVATE:
            raise DamageError("a record is damaged")
        return end

    def _take_metadata(self, record: Metadata) -> None:
        if record.name == RECOVERED:
            self.recovered = record.metadata.get("damage", "").splitlines()
        elif record.name == ROSBAG and self._ours:
            self.metadata = record.metadata.get("serialized_metadata", "")

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

    def _add(self, chunk: _Chunk) -> None:
        """Add a chunk of messages, if it is right."""
        data = self._data(chunk)
        if chunk.checksum and zlib.crc32(data) != chunk.checksum:
            raise DamageError("a chunk of messages fails its checksum")
        block, definitions = records_of(data)
        for opcode, body in definitions:
            self._define(opcode, ReadDataStream(BytesIO(body)))
        plain = unpacked(block)
        if len(plain.places) < len(block.places):
            self._note("packed messages are damaged in a chunk", chunk.start)
        numbers, counts = np.unique(plain.places["source"], return_counts=True)
        counted = dict(zip(numbers.tolist(), counts.tolist(), strict=True))
        self._chunks.append(chunk._replace(counts=counted))

    def _define(self, opcode: int, body: ReadDataStream) -> None:
        """Take the record of a type or a channel."""
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(body)
            self._schemas[schema.id] = schema
            return
        channel = Channel.read(body)
        if (schema := self._schemas.get(channel.schema_id)) is not None:
            found = BagSource(
                topic=channel.topic,
                type=schema.name,
                definition=schema.data.decode(errors="replace"),
                encoding=schema.encoding,
                serialization=channel.message_encoding,
                qos=channel.metadata.get("offered_qos_profiles", ""),
            )
            self.sources.setdefault(channel.id, found)

    def _take_summary(self, footer: Footer, end: int) -> None:
        """Take what the records behind all messages say, if they are right.

        The chunk that has the topics may be damaged.
        """
        start, records = self._summary or (end, [])
        if not self._check(end, footer.summary_crc, start, end):
            return
        for opcode, body in records:
            if opcode == Opcode.STATISTICS:
                self.claimed = dict(Statistics.read(body).channel_message_counts)
            else:
                self._define(opcode, body)

    def _require_checksums(self) -> bool:
        """Leave out chunks without a checksum where others have one; say whether all have it."""
        every = [chunk for chunk in self._chunks if chunk.checksum]
        if every or self._ours:
            for chunk in self._chunks:
                if not chunk.checksum:
                    self._note("a chunk of messages has lost its checksum", chunk.start)
            self._chunks = every
        return len(every) == len(self._chunks)

    def _note(self, what: str, at: int) -> None:
        self._bad.setdefault(what, {})[at] = None

    def _span(self, at: int) -> tuple[int, int, int]:
        """Give a record's opcode, and where its body starts and ends."""
        start = at + _HEAD.size
        if at < 0 or start > self._size:
            raise DamageError("it is cut off")
        opcode, length = _HEAD.unpack(self._read(at, _HEAD.size))
        if length > self._size - start:
            raise DamageError("it is cut off, or a record is damaged")
        return opcode, start, start + length

    def _body(self, start: int, end: int) -> ReadDataStream:
        return ReadDataStream(BytesIO(self._read(start, end - start)))

    def _read(self, at: int, size: int) -> bytes:
        if not 0 <= size <= MAX_SIZE or at < 0:
            raise DamageError("a record is damaged")
        self._file.seek(at)
        return self._file.read(size)

    def _chunk(self, at: int) -> _Chunk:
        """Give the chunk at a place; its sizes are given twice, and must agree."""
        _, start, end = self._span(at)
        unpacked, checksum, length = _CHUNK.unpack(self._read(start, _CHUNK.size))
        if length > 4:
            raise DamageError("a record is damaged")
        text = self._read(start + _CHUNK.size, length + 8)
        size = int.from_bytes(text[length:], "little")
        start += _CHUNK.size + len(text)
        if start + size != end or unpacked > MAX_SIZE or (not length and size != unpacked):
            raise DamageError("a record is damaged")
        return _Chunk(start, size, unpacked, text[:length].decode(), checksum)

    def _data(self, chunk: _Chunk) -> bytes:
        """Read and decompress a chunk; it takes no more memory than it declares."""
        data = self._read(chunk.start, chunk.size)
        if chunk.compression == "lz4":
            data = LZ4FrameDecompressor().decompress(data, max_length=chunk.unpacked + 1)
        elif chunk.compression == "zstd":
            data = b"".join(inflated(data, chunk.unpacked))
        if len(data) != chunk.unpacked:
            raise DamageError("a chunk of messages has another size than it declares")
        return data

    def _end_of_loose(self, at: int) -> int:
        """Find the end of messages without a chunk, of at most a batch."""
        start = at
        while at - start < BATCH:
            try:
                opcode, _, end = self._span(at)
            except DamageError:
                break
            if opcode not in _LOOSE:
                break
            at = end
        return at

    def _next(self) -> int | None:
        """Find the next record behind which reading may continue, of those not seen yet."""
        for place in range(self._resume, self._size, _WINDOW):
            window = self._read(place, min(_WINDOW + 64, self._size - place))
            for found in _RESUMED.finditer(window):
                at = place + found.start()
                try:
                    if window[found.start()] == Opcode.CHUNK:
                        self._chunk(at)
                except _GARBAGE:
                    continue
                self._resume = at + 1
                return at
        return None
