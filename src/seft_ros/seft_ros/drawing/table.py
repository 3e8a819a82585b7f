"""Tables of results: one form, which the terminal and a page draw, each in its own way; csv."""

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from rich import table
from rich.console import Group
from rich.text import Text
from seft_msgs_py.arrays import Floats
from seft_msgs_py.errors import InputError
from seft_msgs_py.printing import escaped

from seft_ros.drawing.style import Mark, check_file

_COLOURS = {Mark.GOOD: "green", Mark.DOUBT: "yellow", Mark.BAD: "red", Mark.NONE: ""}


@dataclass(frozen=True)
class Cell:
    """Text with a mark, in a table or as a line of its own."""

    text: str
    mark: Mark = Mark.NONE

    def __rich__(self) -> Text:
        """Draw it for the terminal."""
        return Text(escaped(self.text), style=_COLOURS[self.mark])


@dataclass(frozen=True)
class TextTable:
    """Rows under headings; columns after the first are aligned to the right where ``numbers``.

    Without headings it is a list of names and values. None among the rows begins a new section. A
    wide one has a page's whole width.
    """

    headings: Sequence[str]
    rows: Sequence[Sequence[str | Cell] | None]
    numbers: bool = True
    wide: bool = False

    def sections(self) -> Iterator[list[list[Cell]]]:
        """All cells, those without a mark too: by section, row by row."""
        section: list[list[Cell]] = []
        for row in self.rows:
            if row is not None:
                section.append([c if isinstance(c, Cell) else Cell(c) for c in row])
            elif section:
                yield section
                section = []
        if section:
            yield section

    def __rich__(self) -> Group | table.Table:
        """Draw it for the terminal: what is too wide is folded, nothing is cut off."""
        if not self.headings:
            rows = (row for section in self.sections() for row in section)
            return Group(
                *(Text.assemble(name.__rich__(), ": ", text.__rich__()) for name, text in rows)
            )
        drawn = table.Table()
        for column, heading in enumerate(self.headings):
            right = self.numbers and column > 0
            side: Literal["right", "left"] = "right" if right else "left"
            drawn.add_column(Text(escaped(heading)), justify=side, overflow="fold")
        for section in self.sections():
            for row in section:
                drawn.add_row(*row)
            drawn.add_section()
        return drawn


Texts = list[str | Cell | TextTable]
"""What a command shows on the terminal, from top to bottom."""


def check_table(path: Path) -> Path:
    """Complete the name of a csv file, before the work is done that it holds.

    An InputError says that there is no such folder, or that the name does not end in .csv.
    """
    return check_file(path, "tables", ".csv", [".csv"])


def write_table(path: Path, names: Sequence[str], table: Floats) -> None:
    """Write columns, shape (N, c), as csv with their names; what is not known (NaN) is empty.

    Raises
    ------
    InputError
        If the file can't be written.
    """
    rows = (["" if value != value else repr(value) for value in row] for row in table.tolist())
    try:
        with path.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows([names, *rows])
    except OSError as error:
        raise InputError(f"{path}: the table can't be written ({error.strerror})") from None
