"""What stands on a page, without how it looks."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from bokeh.model import Model


class Mark(StrEnum):
    """How good something is; the value is its class in the style sheet."""

    GOOD = "good"
    DOUBT = "doubt"
    BAD = "bad"
    NONE = "none"


@dataclass(frozen=True)
class Cell:
    """Text in a table, with a mark."""

    text: str
    mark: Mark = Mark.NONE


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    text: str
    kind: str = "text"


@dataclass(frozen=True)
class Verdict:
    """The line that counts, in the colour of its mark; below it, what it rests on."""

    mark: Mark
    text: str
    findings: Sequence[Cell] = ()
    kind: str = "verdict"


@dataclass(frozen=True)
class Table:
    """Rows under headings; columns after the first stand to the right where ``numbers``.

    Attributes
    ----------
    headings : sequence of str
        One for each column; none: a list of names and values.
    rows : sequence of sequences
        Text, or `Cell` with a mark.
    """

    headings: Sequence[str]
    rows: Sequence[Sequence[str | Cell]]
    numbers: bool = True
    kind: str = "table"

    def cells(self) -> list[list[Cell]]:
        """All cells, those without a mark too."""
        return [[c if isinstance(c, Cell) else Cell(c) for c in row] for row in self.rows]


@dataclass(frozen=True)
class Plot:
    """A zoomable figure, and what it shows.

    Attributes
    ----------
    figure : bokeh Model
        As `seft_ros.page.plots` makes them; figures that share a range zoom together.
    caption : str
        One or two sentences: what to look for.
    wide : bool
        Over the page's whole width; else two stand side by side where there is room.
    """

    figure: Model
    caption: str = ""
    wide: bool = False
    kind: str = "plot"


Block = Text | Verdict | Table | Plot


@dataclass(frozen=True)
class Section:
    """A heading and what stands under it."""

    title: str
    blocks: Sequence[Block] = field(default_factory=tuple)
