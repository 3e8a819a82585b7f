"""What stands on a page, and its file: HTML that needs nothing else. Its look is in templates."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

from bokeh.embed import components
from bokeh.model import Model
from bokeh.resources import Resources
from jinja2 import Environment, PackageLoader, StrictUndefined
from seft_msgs_py.errors import InputError

from seft_ros.drawing.style import check_folder

SUFFIX = ".html"


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

    Without headings it is a list of names and values. A wide one has the page's whole width.
    """

    headings: Sequence[str]
    rows: Sequence[Sequence[str | Cell]]
    numbers: bool = True
    wide: bool = False
    kind: str = "table"

    def cells(self) -> list[list[Cell]]:
        """All cells, those without a mark too."""
        return [[c if isinstance(c, Cell) else Cell(c) for c in row] for row in self.rows]


@dataclass(frozen=True)
class Plot:
    """A zoomable figure of `seft_ros.page.plots`, and in one or two sentences what to look for.

    A wide one has the page's whole width; else two stand side by side where there is room.
    """

    figure: Model
    caption: str = ""
    wide: bool = False
    kind: str = "plot"


@dataclass(frozen=True)
class Grid:
    """Plots side by side, 2 to 4 in a row, where there is room; else one below the other."""

    plots: Sequence[Plot]
    columns: int = 3
    kind: str = "grid"


Block = Text | Verdict | Table | Plot | Grid


@dataclass(frozen=True)
class Section:
    """A heading and what stands under it."""

    title: str
    blocks: Sequence[Block] = field(default_factory=tuple)


def write_page(path: Path, title: str, subtitle: str, sections: Sequence[Section]) -> None:
    """Write a page; figures, the library that draws them, and styles are inside the file.

    An InputError says why it can't be.
    """
    figures = {
        name: plot.figure
        for place, section in enumerate(sections)
        for index, block in enumerate(section.blocks)
        for name, plot in _plots(f"{place}-{index}", block)
    }
    script, places = components(figures) if figures else ("", {})
    library = Resources(mode="inline", components=["bokeh"]).render_js() if figures else ""
    environment = Environment(
        loader=PackageLoader("seft_ros.page", "templates"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    text = environment.get_template("page.html").render(
        title=title,
        subtitle=subtitle,
        sections=sections,
        anchors=[re.sub(r"[^a-z0-9]+", "-", s.title.lower()).strip("-") for s in sections],
        library=library,
        script=script,
        places=places,
    )
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: the page can't be written ({error.strerror})") from None


def _plots(name: str, block: Block) -> list[tuple[str, Plot]]:
    """Name the plots of a block, as the template looks for them."""
    if isinstance(block, Grid):
        return [(f"{name}-{index}", plot) for index, plot in enumerate(block.plots)]
    return [(name, block)] if isinstance(block, Plot) else []


def check_page(path: Path) -> Path:
    """Complete the name of a page's file, before the work is done that it is to show.

    An InputError says that there is no such folder, or that it names another kind of file.
    """
    path = path if path.suffix else path.with_suffix(SUFFIX)
    if path.suffix.lower() not in (SUFFIX, ".htm"):
        raise InputError(f"{path}: pages end in {SUFFIX}")
    return check_folder(path)
