"""A page of text, tables and figures in one HTML file; its look is in the templates."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from bokeh.embed import components
from bokeh.model import Model
from bokeh.resources import Resources
from jinja2 import Environment, PackageLoader, StrictUndefined
from seft_msgs_py.errors import InputError

from seft_ros.drawing.style import check_folder
from seft_ros.drawing.tables import Mark

SUFFIX = ".html"


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
    """The verdict in one line, in the colour of its mark; below it, the findings behind it."""

    mark: Mark
    text: str
    findings: Sequence[Cell] = ()
    kind: str = "verdict"


@dataclass(frozen=True)
class Table:
    """Rows under headings; columns after the first are aligned to the right where ``numbers``.

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
    """A figure of `seft_ros.drawing.plots`, and in one or two sentences what to look for.

    A wide one has the page's whole width; otherwise two are side by side where there is room.
    """

    figure: Model
    caption: str = ""
    wide: bool = False
    kind: str = "plot"


@dataclass(frozen=True)
class Grid:
    """Plots side by side, 2 to 4 in a row, where there is room; otherwise one below the other."""

    plots: Sequence[Plot]
    columns: int = 3
    kind: str = "grid"


Block = Text | Verdict | Table | Plot | Grid


@dataclass(frozen=True)
class Section:
    """A heading and the blocks under it."""

    title: str
    blocks: Sequence[Block] = field(default_factory=tuple)


def write_page(path: Path, title: str, subtitle: str, sections: Sequence[Section]) -> None:
    """Write a page; figures, the library that draws them, and styles are inside the file.

    An InputError says why it can't be written.
    """
    figures = {}  # by the name under which the template looks for them
    for place, section in enumerate(sections):
        for index, block in enumerate(section.blocks):
            if isinstance(block, Plot):
                figures[f"{place}-{index}"] = block.figure
            elif isinstance(block, Grid):
                own = {f"{place}-{index}-{n}": p.figure for n, p in enumerate(block.plots)}
                figures.update(own)
    script, places = components(figures) if figures else ("", {})
    library = Resources(mode="inline", components=["bokeh"]).render_js() if figures else ""
    environment = Environment(
        loader=PackageLoader("seft_ros.drawing", "templates"),
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


def check_page(path: Path) -> Path:
    """Complete the name of a page's file, before the work is done that it shows.

    An InputError says that there is no such folder, or that the suffix is of another kind of file.
    """
    path = path if path.suffix else path.with_suffix(SUFFIX)
    if path.suffix.lower() not in (SUFFIX, ".htm"):
        raise InputError(f"{path}: pages end in {SUFFIX}")
    return check_folder(path)
