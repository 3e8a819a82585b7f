"""Records in columns: separated by white space, commas or semicolons, with any header."""

import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError

from seft_ros.ground_motion.text_file import (
    COMMENT_MARKS,
    NUMBER,
    is_comment,
    not_finite,
    read_unit,
    to_float,
)

_LIKE_A_NUMBER = re.compile(r"[+-]?\.?\d")
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,0\d+")  # a lone 0,005 would read as two columns
_NOT_FINITE = ("nan", "inf", "infinity")
_IN_BRACKETS = re.compile(r"[\[(]([^\[\]()]+)[\])]")
_TIME = re.compile(r"(?:time|t)[\s_,/]*[\[(]?\s*([a-z]*)\s*[\])]?", re.IGNORECASE)
_SECONDS = {
    **dict.fromkeys(("", "s", "sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "milliseconds"), 1e-3),
}
_UNEVEN = 0.01  # of a step


@dataclass(frozen=True)
class Columns:
    """Numbers of a record in columns; those of an AT2 file are one.

    Attributes
    ----------
    path : Path
        The file.
    values : ndarray
        Shape (N, c), as they stand; may hold NaN and infinities.
    lines : list of str
        The file's lines.
    start : int
        Index of the first data line.
    names : tuple of str
        Column names from the line above the data; empty if it names no c columns.
    header_line : int
        Number of that line; 0: there is none, or AT2's.
    own_dt : float or None
        Sampling period that the header gives, s; None: a column of time may.
    """

    path: Path
    values: npt.NDArray[np.float64]
    lines: list[str]
    start: int
    names: tuple[str, ...] = ()
    header_line: int = 0
    own_dt: float | None = None

    @property
    def header(self) -> str:
        """Where names and units stand."""
        return f"the header (line {self.header_line})" if self.header_line else "the header"

    @property
    def units(self) -> tuple[str | None, ...]:
        """Acceleration unit in the brackets of each column's name, ``acc (g)``, or None."""
        if not self.names:
            return (None,) * self.values.shape[1]
        found = (_IN_BRACKETS.search(name) for name in self.names)
        return tuple(read_unit(unit.group(1)) if unit else None for unit in found)

    @cached_property
    def time(self) -> tuple[int, float] | None:
        """Index of the column whose name says time, and its unit in s; None if there is none."""
        for index, name in enumerate(self.names):
            found = _TIME.fullmatch(name)
            if found and found.group(1).lower() in _SECONDS:
                return index, _SECONDS[found.group(1).lower()]
        return None

    def dt(self) -> float | None:
        """Find the sampling period in the header or the column of time, s; None: in neither.

        Raises
        ------
        InputError
            If the times do not increase evenly, within 1 % of the usual step; names the line.
        """
        if self.time is None:
            return self.own_dt
        column, unit = self.time
        self.check_finite(column)
        times = self.values[:, column]
        steps = np.diff(times)
        typical = float(np.median(steps))
        uneven = np.flatnonzero(np.abs(steps - typical) > _UNEVEN * abs(typical))
        if typical <= 0 or uneven.size:
            row = int(uneven[0]) + 1 if uneven.size else 1
            raise InputError(
                f"{self.path}: line {self._line_of(row)}: time goes from {times[row - 1]:g} to "
                f"{times[row]:g}, but its usual step is {typical:g}; resample the record evenly"
            )
        return float(f"{unit * (times[-1] - times[0]) / len(steps):.12g}")  # not 0.00500...1

    def check_finite(self, column: int) -> None:
        """Refuse a column with a NaN or an infinity; names the line."""
        bad = np.flatnonzero(~np.isfinite(self.values[:, column]))
        if bad.size:
            row = int(bad[0])
            raise not_finite(self.values[row, column], self.path, self._line_of(row))

    def _line_of(self, row: int) -> int:
        return _data_lines(self.lines, self.start)[row][0]


def read_columns(path: Path, lines: list[str]) -> Columns:
    """Read the numbers of a file in columns.

    Comment lines (%, #, //, !, ;) and blank lines may stand anywhere, lines of text above
    the data.

    Raises
    ------
    InputError
        At text in the data, or where the number of columns changes; names the line.
    """
    start, separator = _find_data(path, lines)
    try:
        values = np.loadtxt(lines[start:], delimiter=separator, comments=None, ndmin=2)
    except ValueError:  # comments among the data, or a fault
        values = _read_by_line(path, lines, start, separator)
    count = values.shape[1]
    names: tuple[str, ...] = ()
    header = start
    for number, line in enumerate(lines[:start], start=1):
        fields = _fields(line, separator)
        suspect = any(_is_number(field) or _LIKE_A_NUMBER.match(field) for field in fields)
        if len(fields) == count and suspect and not is_comment(line):
            for field in fields:
                to_float(field, path, number)
        if line.strip():
            header, names = number, _names(line, separator, count)
    return Columns(path, values, lines, start, names, header)


def _find_data(path: Path, lines: list[str]) -> tuple[int, str | None]:
    """Index of the first line that holds only numbers, and its separator (None: white space)."""
    candidate = None
    for index, line in enumerate(lines):
        if not line.strip() or is_comment(line):
            continue
        separator = ";" if ";" in line else "," if "," in line else None
        if _DECIMAL_COMMA.fullmatch(line.strip()):
            to_float(line.strip(), path, index + 1)
        if all(_is_number(field) for field in _fields(line, separator)):
            return index, separator
        if candidate is None and _LIKE_A_NUMBER.match(line.strip()):
            candidate = index, separator
    if candidate:
        for field in _fields(lines[candidate[0]], candidate[1]):
            to_float(field, path, candidate[0] + 1)
    raise InputError(f"{path}: holds no line of numbers; give a record in columns, or AT2")


def _read_by_line(
    path: Path, lines: list[str], start: int, separator: str | None
) -> npt.NDArray[np.float64]:
    rows: list[list[float]] = []
    data = _data_lines(lines, start)
    for number, line in data:
        fields = _fields(line, separator)
        if rows and len(fields) != len(rows[0]):
            half = number == data[-1][0] and len(fields) < len(rows[0])
            what = "a half-written last row: " if half else ""
            mend = "remove it, or fetch the record again" if half else "make the columns even"
            raise InputError(
                f"{path}: line {number}: {what}{len(fields)} columns, but {len(rows[0])} "
                f"before; {mend}"
            )
        rows.append([to_float(field, path, number) for field in fields])
    return np.array(rows)


def _data_lines(lines: list[str], start: int) -> list[tuple[int, str]]:
    return [
        (number, line)
        for number, line in enumerate(lines[start:], start=start + 1)
        if line.strip() and not is_comment(line)
    ]


def _fields(line: str, separator: str | None) -> list[str]:
    if separator is None:
        return line.split()
    return [field.strip() for field in line.strip().removesuffix(separator).split(separator)]


def _is_number(field: str) -> bool:
    return bool(NUMBER.fullmatch(field)) or field.lstrip("+-").lower() in _NOT_FINITE


def _names(line: str, separator: str | None, count: int) -> tuple[str, ...]:
    """Column names in a header line, if it splits into as many as there are columns."""
    text = line.strip()
    for mark in COMMENT_MARKS:
        text = text.removeprefix(mark)
    text = text.strip()
    ways = (
        _fields(text, separator),
        re.split(r"\t+|\s{2,}", text),
        _fields(text, ","),
        _fields(text, ";"),
    )
    for fields in ways:
        if len(fields) == count:
            return tuple(field.strip().strip("\"'").strip() for field in fields)
    return ()
