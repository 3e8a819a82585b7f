"""An sqlite3 file of a bag, and what is left of a damaged one.

rosbags counts all rows when it opens a file, and so refuses one with a single damaged page.
"""

import shutil
import sqlite3
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from itertools import batched
from pathlib import Path
from typing import Any

from seft_ros.bags.message_blocks import MessageBlock, unpacked
from seft_ros.bags.source import BagSource

_ROWS = 2048  # messages that are joined to a block
_FINER = 20  # share of the rows lost at a damaged page, by which the next try skips more
_MAX_SKIPPED_ROWS = 1 << 40  # rows that are skipped in search of readable ones
_GARBAGE = (sqlite3.DatabaseError, UnicodeDecodeError, KeyError, TypeError)
"""What a damaged file makes of names and values."""


class SqliteFile:
    """An sqlite3 file, checked when it is opened; attributes as of an `McapFile`.

    It has no checksums: a sample that was changed is not noticed.

    Parameters
    ----------
    path : Path
        The file, which is not changed.
    scratch : Path
        Folder for a copy, in which sqlite takes back what its writer did not finish.
    """

    checked = False
    claimed: dict[int, int] | None = None
    recovered: tuple[str, ...] = ()
    metadata = ""

    def __init__(self, path: Path, scratch: Path) -> None:
        self.sources: dict[int, BagSource] = {}
        self.damage: list[str] = []
        self._odd = 0  # rows that hold no message
        self._database = sqlite3.connect(_copied(path, scratch))
        try:
            # the only switch by which sqlite reads a file that is shorter than it should be
            self._database.execute("PRAGMA writable_schema = ON")
            self.sources = _sources(self._database)
            ((verdict,),) = self._database.execute("PRAGMA quick_check(1)").fetchall()
        except _GARBAGE as error:
            verdict = str(error) if isinstance(error, sqlite3.Error) else "its tables are damaged"
        blocks = self.blocks({number: number for number in self.sources})
        self.counts = Counter(n for block in blocks for n in block.places["source"].tolist())
        if verdict != "ok":
            self.damage.append(" ".join(str(verdict).split()))
        if self._odd:
            self.damage.append(f"{self._odd} rows hold no message")

    def blocks(self, numbers: Mapping[int, int]) -> Iterator[MessageBlock]:
        """Give the messages of some sources; ``numbers`` are what blocks have as their sources."""
        self._odd = 0
        wanted = (row for row in self._rows() if row[1] in numbers)
        for rows in batched(wanted, _ROWS):
            _, sources, times, raws = zip(*rows, strict=True)
            block = MessageBlock.of(times, [numbers[number] for number in sources], raws)
            plain = unpacked(block)
            self._odd += len(block.places) - len(plain.places)
            if len(plain.places):
                yield plain

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def _rows(self) -> Iterator[tuple[int, int, int, bytes]]:
        """Give id, topic, time in ns and message, by id; go on behind damaged pages."""
        query = "SELECT id, topic_id, timestamp, data FROM messages WHERE id > ? ORDER BY id"
        last, skipped = -1, 0
        while skipped < _MAX_SKIPPED_ROWS:
            try:
                for row in self._database.execute(query, (last + skipped,)):
                    if _is_message(*row) and row[1] in self.sources:
                        last, skipped = max(last + skipped, row[0]), 0
                        yield row
                    else:
                        self._odd += 1
                return
            except _GARBAGE:
                skipped += 1 + skipped // _FINER


def _is_message(number: Any, topic: Any, time: Any, data: Any) -> bool:
    numbers = all(isinstance(one, int) and one >= 0 for one in (number, topic, time))
    return numbers and isinstance(data, bytes)


def _copied(path: Path, scratch: Path) -> Path:
    """Copy a file, with what its writer had begun, and without half a page at its end."""
    copy = scratch / "bag.db3"
    copy.unlink(missing_ok=True)
    for end in ("", "-journal", "-wal"):
        if (part := path.with_name(path.name + end)).is_file():
            shutil.copyfile(part, scratch / f"bag.db3{end}")
    with copy.open("r+b") as file:
        page = int.from_bytes(file.read(18)[16:], "big") or 1
        page = 65536 if page == 1 else page
        file.truncate(copy.stat().st_size // page * page)
    return copy


def _sources(database: sqlite3.Connection) -> dict[int, BagSource]:
    definitions: dict[str, tuple[str, str]] = {}
    rows = "SELECT topic_type, encoded_message_definition, encoding FROM message_definitions"
    with suppress(sqlite3.OperationalError):  # old recorders have no such table
        definitions = {name: (text, kind) for name, text, kind in database.execute(rows)}
    database.row_factory = sqlite3.Row
    found = [dict(row) for row in database.execute("SELECT * FROM topics")]
    database.row_factory = None
    sources = {}
    for row in found:
        definition, encoding = definitions.get(row["type"], ("", "ros2msg"))
        names = row["name"], row["type"], definition, encoding, row["serialization_format"]
        if isinstance(row["id"], int) and all(isinstance(text, str) for text in names):
            sources[row["id"]] = BagSource(*names, str(row.get("offered_qos_profiles", "")))
    return sources
