"""How a result is read: one description of each number serves tables, pages, figures and JSON."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from rich.table import Table
from rich.text import Text

DISPLAY_UNITS = {
    "displacement": ("mm", 1e3),
    "force": ("N", 1.0),
    "acceleration": ("m/s²", 1.0),
    "delay": ("ms", 1e3),
    "stiffness": ("kN/m", 1e-3),
    "damping": ("N s/m", 1.0),
}
"""Quantity -> the unit in which it is displayed, and the factor from SI."""
RESPONSES = ("displacement", "force", "acceleration")
"""Quantities of a test, in the order in which they are displayed."""

GOOD_ERROR = 0.05
"""Displacement error (nrmse) up to which a test is shown in green."""

_LEAST = 0.001  # %
_LEFT: dict[str, Any] = {"title_justify": "left", "title_style": "", "caption_justify": "left"}
CENTRED: dict[str, Any] = {"title_justify": "center", "title_style": None, "caption_style": None}
"""Options of a table whose title is centred, in italics."""


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
        """Find the number in a result and write it, with its unit and frequency."""
        value, hz = look_up(result, self.key), look_up(result, self.at) if self.at else None
        if value is None or isinstance(value, str):
            return self.plain(result)
        text = f"{self.plain(result)} {self.unit}".rstrip()
        return text if hz is None else f"{text} at {hz:.3g} Hz"

    def plain(self, result: Any) -> str:
        """Write the number without its unit; a string stays as it is."""
        value = look_up(result, self.key)
        if value is None:
            return self.missing
        if isinstance(value, str):
            return value
        return self.form(value) if callable(self.form) else f"{value * self.scale:{self.form}}"


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
    return f"{name} / {unit}" if unit else name


def number(value: float | None, scale: float = 1.0, unit: str = "", form: str = ".4g") -> str:
    """Write a number in a unit; a dash where there is none."""
    return Number("", "", unit, scale, form).text(value)


def percent(value: float | None, sign: str = "") -> str:
    """Write a ratio as a percentage of three digits; a dash where there is none.

    ``sign`` is "+" where positive ones have a sign, too.
    """
    if value is None:
        return "-"
    form = f"{sign}.0f" if value == 0 or abs(value) >= 10 else f"{sign}#.3g"
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


def make_table(
    headings: Sequence[str],
    rows: Iterable[Sequence[str | Text] | None],
    *,
    left: Sequence[int] = (0,),
    wrap: bool = False,
    **options: Any,
) -> Table:
    """Draw a table for the terminal.

    Parameters
    ----------
    headings : sequence of str
        One for each column.
    rows : iterable of sequences
        Cells; None draws a line between sections.
    left : sequence of int
        Columns aligned to the left; the others are aligned to the right.
    wrap : bool
        Whether cells may be wrapped in a narrow terminal.
    **options : Any
        Of `rich.table.Table`; title and caption are to the left and plain by default.
    """
    table = Table(**{**_LEFT, "caption_style": "", **options})
    for column, heading in enumerate(headings):
        table.add_column(heading, justify="left" if column in left else "right", no_wrap=not wrap)
    for row in rows:
        if row is None:
            table.add_section()
        else:
            table.add_row(*row)
    return table
