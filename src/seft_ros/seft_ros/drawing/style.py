"""How results look: the one style of figures, and of numbers and tables for all outputs.

Pages take their colours from here, too: matplotlib is imported where it draws.
"""

import csv
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt
from rich import table
from rich.console import Group
from rich.text import Text
from seft_msgs_py.arrays import Floats
from seft_msgs_py.errors import InputError
from seft_msgs_py.files import check_regular
from seft_msgs_py.printing import escaped

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

AnyFloats = npt.NDArray[np.floating[Any]]

MAX_POINTS = 4000
"""Points of a line; more than twice the pixels of a wide screen."""
REFERENCE = "#9aa3ad"  # what should be
FIRST_COLOUR = "#0b5fa5"  # what is
SECOND = "#3d8c40"
OTHERS = (FIRST_COLOUR, SECOND, "#d9822b", "#7b4fa3", "#00857c", "#8a5a2b")
"""Colours of lines that are compared with one in `REFERENCE`, in turn."""
MARK = "#c1272d"
GRID = "#e6e9ec"
TEXT = "#33383d"


def new_figure(width: float, height: float) -> "Figure":
    """Make an empty figure, sizes in inches, that does not touch the user's pyplot."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def tidy(panel: "Axes") -> None:
    """Give a panel the grid, the ticks and the frame that all panels have."""
    panel.grid(color=GRID, lw=0.8)
    panel.set_axisbelow(True)
    panel.tick_params(colors=TEXT, labelsize=9)
    panel.spines[["top", "right"]].set_visible(False)


def finish(figure: "Figure", labelled: "Iterable[Axes]", title: str) -> None:
    """Give a figure its title, and below a legend of the lines with a label in these panels.

    The constrained layout makes room for the legend. (matplotlib before 3.7 has no place
    "outside lower center".)
    """
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    figure.align_ylabels()
    shown = (zip(*panel.get_legend_handles_labels(), strict=True) for panel in labelled)
    entries = {label: handle for panel in shown for handle, label in panel}
    look: dict[str, Any] = {"loc": "lower center", "frameon": False, "borderaxespad": 0.2}
    legend = figure.legend(list(entries.values()), list(entries), ncols=4, **look)
    height = legend.get_window_extent().height / figure.bbox.height
    layout = figure.get_layout_engine()
    assert isinstance(layout, ConstrainedLayoutEngine)
    layout.set(rect=(0.0, height, 1.0, 1.0 - height))
    figure.suptitle(title, fontsize=11, color=TEXT, parse_math=False)


def check_figure(path: Path) -> Path:
    """Complete the name of a figure's file, before the work is done that it shows.

    An InputError says that there is no such folder, or that figures have no such format.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    known = [f".{name}" for name in FigureCanvasAgg.filetypes]
    return check_file(path, "figures", ".png", known)


def check_file(path: Path, what: str, suffix: str, known: Sequence[str]) -> Path:
    """Complete the name of a file by a suffix, before the work is done that it holds.

    An InputError says that there is no such folder, that such files have no such suffix, or that
    the file is a folder, a pipe or a device.
    """
    path = path if path.suffix else path.with_suffix(suffix)
    if path.suffix.lower() not in known:
        raise InputError(f"{path}: {what} end in {', '.join(known)}")
    if not path.parent.is_dir():
        mend = "name a file in a folder that exists"
        raise InputError(f"{path}: there is no folder {path.parent}; {mend}")
    check_regular(path)
    return path


def save_figure(figure: "Figure", path: str | Path) -> None:
    """Save a figure in the format of the suffix, png without one; an InputError says why not."""
    try:
        figure.savefig(path, dpi=150)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error).splitlines()[0]
        raise InputError(f"{path}: the figure can't be saved ({reason})") from None


def thinned(y: AnyFloats) -> npt.NDArray[np.int64]:
    """Choose about `MAX_POINTS` of N samples that draw the same picture; all of fewer samples.

    They are the smallest and the largest of each stretch; indices increase.
    """
    count = len(y)
    if count <= MAX_POINTS:
        return np.arange(count)
    length = -(-count // (MAX_POINTS // 2))
    starts = np.arange(0, count, length)
    # the last stretch is filled up with its last sample
    rows = np.pad(np.nan_to_num(y), (0, len(starts) * length - count), "edge").reshape(-1, length)
    places = (starts + rows.argmin(axis=1), starts + rows.argmax(axis=1), [0, count - 1])
    return np.unique(np.concatenate(places))


DISPLAY_UNITS = {
    "displacement": ("mm", 1e3),
    "force": ("N", 1.0),
    "acceleration": ("m/s²", 1.0),
    "delay": ("ms", 1e3),
    "stiffness": ("kN/m", 1e-3),
    "damping": ("N s/m", 1.0),
    "friction": ("N", 1.0),
}
"""Quantity -> the unit in which it is displayed, and the factor from SI."""
RESPONSES = ("displacement", "force", "acceleration")
"""Quantities of a test, in the order in which they are displayed."""

GOOD_ERROR = 0.05
"""Displacement error (nrmse) up to which a test is shown in green."""

_LEAST = 0.001  # %


class Mark(StrEnum):
    """How good something is; the value is its class in a page's style sheet."""

    GOOD = "good"
    DOUBT = "doubt"
    BAD = "bad"
    NONE = "none"


@dataclass(frozen=True)
class Number:
    """One number of a result, as it is displayed.

    Attributes
    ----------
    label : str
        Its name in a table or beside an axis.
    key : str
        Its place in the result, with a dot between levels; empty: the result itself.
    unit : str
        In which it is displayed.
    scale : float
        Factor from SI to that unit.
    form : str or callable
        Format of the number, or what makes its text from the value.
    missing : str
        Text where it is None.
    at : str
        Key of the frequency, Hz, that belongs to it.
    """

    label: str
    key: str = ""
    unit: str = ""
    scale: float = 1.0
    form: str | Callable[[Any], str] = ".4g"
    missing: str = "-"
    at: str = ""

    def text(self, result: Any) -> str:
        """Find the number in a result and write it, with its unit and frequency.

        A string stays as it is.
        """
        value, hz = look_up(result, self.key), look_up(result, self.at) if self.at else None
        if value is None:
            return self.missing
        if isinstance(value, str):
            return value
        text = self.form(value) if callable(self.form) else f"{value * self.scale:{self.form}}"
        text = f"{text} {self.unit}".rstrip()
        return text if hz is None else f"{text} at {hz:.3g} Hz"


def look_up(result: Any, key: str) -> Any:
    """Find the value of a dotted key in nested mappings; None where there is none."""
    if isinstance(result, Mapping) and key in result:  # such as p99.9
        return result[key]
    for part in key.split(".") if key else ():
        result = result.get(part) if isinstance(result, Mapping) else None
    return result


def rows_of(numbers: Iterable[Number], *results: Any) -> list[list[str]]:
    """Make a row of each number: its label, and its text in each result."""
    return [[number.label, *(number.text(result) for result in results)] for number in numbers]


def axis_label(name: str) -> str:
    """Label an axis of a figure with a quantity and its unit, if it has a known one."""
    unit, _ = DISPLAY_UNITS.get(name, ("", 1.0))
    unit = f"({unit})" if "/" in unit or " " in unit else unit
    return f"{name} / {unit}" if unit else name


def number(value: float | None, scale: float = 1.0, unit: str = "", form: str = ".4g") -> str:
    """Write a number in a unit; a dash where there is none."""
    return Number("", "", unit, scale, form).text(value)


def percent(value: float | None) -> str:
    """Write a ratio as a percentage of three digits; a dash where there is none."""
    if value is None:
        return "-"
    form = ".0f" if value == 0 or abs(value) >= 10 else "#.3g"
    return f"{value * 100:{form}} %".replace(". %", " %")


def small_percent(value: float | None) -> str:
    """Write a ratio as `percent` does, but none of the far too small ones."""
    return f"<{_LEAST:g} %" if value is not None and 0 < value * 100 < _LEAST else percent(value)


def json_safe(value: Any) -> Any:
    """Replace what JSON has no number for by None, in dicts and lists too."""
    if isinstance(value, dict):
        return {key: json_safe(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [json_safe(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value


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
            rows = (map(Cell.__rich__, row) for section in self.sections() for row in section)
            return Group(*(Text.assemble(name, ": ", text) for name, text in rows))
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
