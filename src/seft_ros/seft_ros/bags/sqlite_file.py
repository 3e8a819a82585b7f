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
from seft_ros.bags.source import Source

_ROWS = 2048  # messages that are joined to a block
_FINER = 20  # share of the rows lost at a damaged page, by which the next try skips more
_FARTHEST = 1 << 40  # rows that are skipped in search of readable ones

_Row = tuple[int, int, int, bytes]  # id, number of the source, log time in ns, message


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
        self.sources: dict[int, Source] = {}
        self._odd = 0  # rows that hold no message
        verdict = "ok"
        self._database = _opened(path, scratch)
        try:
            verdict = self._database.execute("PRAGMA quick_check(1)").fetchone()[0]
            self.sources = _sources(self._database)
        except (sqlite3.DatabaseError, KeyError, TypeError, UnicodeDecodeError) as error:
            verdict = str(error) if isinstance(error, sqlite3.Error) else "its tables are damaged"
        self.counts: Counter[int] = Counter()
        for block in self.blocks({number: number for number in self.sources}):
            self.counts.update(block.places["source"].tolist())
        if not path.stat().st_size:
            verdict = "it is empty"
        self.damage = [] if verdict == "ok" else [" ".join(str(verdict).split())]
        if self._odd:
            self.damage.append(f"{self._odd} rows hold no message")

    def blocks(self, numbers: Mapping[int, int]) -> Iterator[MessageBlock]:
        """Give the messages of some sources; ``numbers`` are what blocks have as their sources."""
        self._odd = 0
        for rows in batched(self._rows(), _ROWS):
            wanted = [row for row in rows if row[1] in numbers]
            if wanted:
                _, sources, times, raws = zip(*wanted, strict=True)
                block = MessageBlock.of(times, [numbers[n] for n in sources], raws)
                plain = unpacked(block)
                self._odd += len(block.places) - len(plain.places)
                if len(plain.places):
                    yield plain

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def _rows(self) -> Iterator[_Row]:
        """Give the messages in the order of their numbers; go on behind damaged pages."""
        query = "SELECT id, topic_id, timestamp, data FROM messages WHERE id > ? ORDER BY id"
        last, skipped = -1, 0
        while skipped < _FARTHEST:
            try:
                for row in self._database.execute(query, (last + skipped,)):
                    if not _is_message(row) or row[1] not in self.sources:
                        self._odd += 1
                        continue
                    last, skipped = max(last + skipped, row[0]), 0
                    yield row
                return
            except (sqlite3.DatabaseError, UnicodeDecodeError):
                skipped += 1 + skipped // _FINER


def _is_message(row: tuple[Any, ...]) -> bool:
    number, topic, time, data = row
    numbers = all(isinstance(one, int) and one >= 0 for one in (number, topic, time))
    return numbers and isinstance(data, bytes)


def _opened(path: Path, scratch: Path) -> sqlite3.Connection:
    """Open a file to read it; a copy, if it is not as sqlite would leave it."""
    place = scratch / "bag.db3"  # the name may have what means something to sqlite
    place.unlink(missing_ok=True)
    journals = [path.with_name(path.name + end) for end in ("-journal", "-wal")]
    with path.open("rb") as file:
        head = file.read(32)
    size, page = path.stat().st_size, int.from_bytes(head[16:18], "big")
    page = 65536 if page == 1 else max(1, page)
    pages = size // page
    unfinished = any(journal.is_file() for journal in journals)
    if not unfinished and int.from_bytes(head[28:32], "big") <= pages:
        place.symlink_to(path.resolve())
    else:
        shutil.copyfile(path, place)
        if unfinished:
            for journal in filter(Path.is_file, journals):
                shutil.copyfile(
                    journal, place.with_name(journal.name.replace(path.name, place.name))
                )
            with suppress(sqlite3.Error), sqlite3.connect(place) as database:
                database.execute("SELECT count(*) FROM sqlite_master").fetchone()
            database.close()
        if len(head) == 32 and place.stat().st_size // page <= pages:
            with place.open("r+b") as file:  # sqlite reads none of a file that is cut off
                file.truncate(pages * page)
                file.seek(28)
                file.write(pages.to_bytes(4, "big"))
    return sqlite3.connect(f"file:{place}?mode=ro&immutable=1", uri=True)


def _sources(database: sqlite3.Connection) -> dict[int, Source]:
    definitions: dict[str, tuple[str, str]] = {}
    rows = "SELECT topic_type, encoded_message_definition, encoding FROM message_definitions"
    with suppress(sqlite3.OperationalError):  # old recorders have no such table
        definitions = {name: (text, kind) for name, text, kind in database.execute(rows)}
    found = database.execute("SELECT * FROM topics")
    columns = [column[0] for column in found.description]
    sources = {}
    for values in found:
        row = dict(zip(columns, values, strict=True))
        texts = (row["name"], row["type"], row["serialization_format"])
        if isinstance(row["id"], int) and all(isinstance(text, str) for text in texts):
            definition, encoding = definitions.get(row["type"], ("", "ros2msg"))
            qos = row.get("offered_qos_profiles", "")
            sources[row["id"]] = Source(texts[0], texts[1], definition, encoding, texts[2], qos)
    return sources
