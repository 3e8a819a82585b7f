"""Records in columns: separated by white space, commas or semicolons, with any header."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError

from seft_ros.ground_motion.text_file import COMMENT_MARKS, NUMBER, is_comment, to_float

_LIKE_A_NUMBER = re.compile(r"[+-]?\.?\d")
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,0\d+")  # a lone 0,005 would read as two columns
_NOT_FINITE = ("nan", "inf", "infinity")


@dataclass(frozen=True)
class ColumnFile:
    """Numbers of a file in columns.

    Attributes
    ----------
    values : ndarray
        Shape (N, c), as they stand; may hold NaN and infinities.
    names : tuple of str
        Column names from the line above the data; empty if it names no c columns.
    header_line : int
        Number of that line.
    lines : list of str
        The file's lines.
    start : int
        Index of the first data line.
    """

    values: npt.NDArray[np.float64]
    names: tuple[str, ...]
    header_line: int
    lines: list[str]
    start: int

    def line_of(self, row: int) -> int:
        """Line number of a row of `values`."""
        return [number for number, _ in _data_lines(self.lines, self.start)][row]


def read_columns(path: Path, lines: list[str]) -> ColumnFile:
    """Read the numbers of a file in columns.

    Comment lines (%, #, //, !, ;) and blank lines may stand anywhere, lines of text above
    the data.

    Parameters
    ----------
    path : Path
        Name for the errors.
    lines : list of str
        The file's lines.

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
    return ColumnFile(values, names, header, lines, start)


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
