"""An sqlite3 file of a bag; of a damaged one, what stands before the damage.

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

from seft_ros.bags.mcap_file import BagSource
from seft_ros.bags.message_blocks import MessageBlock, unpacked

_ROWS = 2048  # messages that are joined to a block
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
        for end in ("", "-journal", "-wal"):
            if (part := path.with_name(path.name + end)).is_file():
                shutil.copyfile(part, scratch / f"bag.db3{end}")
        with (scratch / "bag.db3").open("r+b") as copy:
            page = int.from_bytes(copy.read(18)[16:], "big") or 1
            page = 65536 if page == 1 else page
            copy.truncate(copy.seek(0, 2) // page * page)  # sqlite takes half a page for a whole
        self._database = sqlite3.connect(scratch / "bag.db3")
        try:
            # the only switch by which sqlite reads a file that is shorter than it should be
            self._database.execute("PRAGMA writable_schema = ON")
            self.sources = _sources(self._database)
            ((verdict,),) = self._database.execute("PRAGMA quick_check(1)").fetchall()
        except _GARBAGE as error:
            verdict = str(error) if isinstance(error, sqlite3.Error) else "its tables are damaged"
        blocks = self.blocks({number: number for number in self.sources})
        self.counts = Counter(n for block in blocks for n in block.places["source"].tolist())
        if verdict == "ok":
            ((rows,),) = self._database.execute("SELECT count(*) FROM messages")
            odd = rows - self.counts.total()
            verdict = f"{odd} rows hold no message" if odd else verdict
        if verdict != "ok":
            self.damage.append(" ".join(str(verdict).split()))

    def blocks(self, numbers: Mapping[int, int]) -> Iterator[MessageBlock]:
        """Give the messages of some sources; ``numbers`` are what blocks have as their sources."""
        wanted = (row for row in self._rows() if row[0] in numbers)
        for rows in batched(wanted, _ROWS):
            sources, times, raws = zip(*rows, strict=True)
            yield unpacked(MessageBlock.of(times, [numbers[number] for number in sources], raws))

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def _rows(self) -> Iterator[tuple[int, int, bytes]]:
        """Give topic, time in ns and message, in the order of writing, up to the first damage."""
        query = "SELECT topic_id, timestamp, data FROM messages ORDER BY id"
        with suppress(*_GARBAGE):
            for row in self._database.execute(query):
                if tuple(map(type, row)) == (int, int, bytes):
                    yield row


def _sources(database: sqlite3.Connection) -> dict[int, BagSource]:
    definitions: dict[str, tuple[str, str]] = {}
    rows = "SELECT topic_type, encoded_message_definition, encoding FROM message_definitions"
    with suppress(sqlite3.OperationalError):  # old recorders have no such table
        definitions = {name: (text, kind) for name, text, kind in database.execute(rows)}
    topics = database.execute("SELECT * FROM topics")
    columns = [name for name, *_ in topics.description]
    sources = {}
    for row in (dict[str, Any](zip(columns, values, strict=True)) for values in topics):
        definition, encoding = definitions.get(row["type"], ("", "ros2msg"))
        names = row["name"], row["type"], definition, encoding, row["serialization_format"]
        if isinstance(row["id"], int) and all(isinstance(text, str) for text in names):
            sources[row["id"]] = BagSource(*names, str(row.get("offered_qos_profiles", "")))
    return sources
