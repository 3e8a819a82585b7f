"""Records in columns: separated by white space, commas or semicolons, with any header."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError

STANDARD_GRAVITY = 9.80665
"""Standard acceleration of gravity in m/s^2, exact by definition (ISO 80000-3)."""

UNITS = {"g": STANDARD_GRAVITY, "m/s2": 1.0, "cm/s2": 0.01}
"""Unit in a parameter file -> its size in m/s^2."""

NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[EeDd][+-]?\d+)?", re.ASCII)
"""A number of Fortran, C or a spreadsheet; D is Fortran's double exponent."""

_COMMENT_MARKS = ("%", "#", "//", "!", ";")
_NOT_FINITE = re.compile(r"[+-]?(?:nan|inf|infinity)", re.IGNORECASE)
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+")
_LONE_DECIMAL_COMMA = re.compile(r"[+-]?\d+,0\d+")  # 0,005 would read as two columns
_LIKE_A_NUMBER = re.compile(r"[+-]?\.?\d")
_IN_BRACKETS = re.compile(r"[\[(]([^\[\]()]+)[\])]")
_IN_UNIT = re.compile(r"\bin\s+(?:units?\s+of\s+)?([^\s,;()\[\]]+)", re.IGNORECASE)
_DT = re.compile(rf"\bdt\s*[=:]\s*({NUMBER.pattern})\s*(ms\b)?", re.IGNORECASE | re.ASCII)
_TIME = re.compile(r"(?:time|t)[\s_,/]*[\[(]?\s*([a-z]*)\s*[\])]?", re.IGNORECASE)
_SECONDS = {
    **dict.fromkeys(("", "s", "sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "milliseconds"), 1e-3),
}
_UNEVEN = 0.01  # of a step
_FEWEST_TIMES = 10
_LONGEST_STEP = 0.1  # s; records are sampled faster


@dataclass(frozen=True)
class Columns:
    """Numbers of a record in columns; those of an AT2 file are one column.

    Attributes
    ----------
    path : Path
        The file.
    values : ndarray
        Shape (N, c), in the file's units; may contain NaN and infinities.
    lines : list of int
        Number of the line of each row, or of each value of AT2.
    names : tuple of str
        Column names from the line above the data; empty if it does not name c columns.
    header : str
        Number of that line in brackets, as errors name it; empty: there is none, or it is an AT2
        file.
    own_dt : float or None
        Sampling period in the header, s; None: a column of time may give it.
    own_unit : str or None
        Acceleration unit in the header; None: the name of a column may give it.
    """

    path: Path
    values: npt.NDArray[np.float64]
    lines: list[int]
    names: tuple[str, ...] = ()
    header: str = ""
    own_dt: float | None = None
    own_unit: str | None = None

    def unit(self, column: int) -> str | None:
        """Acceleration unit in the brackets of a column's name, ``acc (g)``, or of the header."""
        found = _IN_BRACKETS.search(self.names[column]) if self.names else None
        return (read_unit(found.group(1)) if found else None) or self.own_unit

    def time(self) -> tuple[int, float] | None:
        """Index of the column of time, and its unit in s; None if there is none.

        It is the column with the name time. Without such a name, it is the first of several columns
        that rises from line to line, in steps of up to 0.1 s.
        """
        named = [_TIME.fullmatch(name) for name in self.names]
        for index, found in enumerate(named):
            if found and found.group(1).lower() in _SECONDS:
                return index, _SECONDS[found.group(1).lower()]
        if any(named):
            return None
        rises = [self.rise(index) for index in range(self.values.shape[1])]
        return next(((k, 1.0) for k, step in enumerate(rises) if 0 < step <= _LONGEST_STEP), None)

    def rise(self, column: int) -> float:
        """Give the usual step of one of several columns that rises like time; 0: it does not."""
        steps = np.diff(self.values[:, column])
        few = len(steps) < _FEWEST_TIMES - 1 or self.values.shape[1] == 1
        return 0.0 if few or not (steps > 0).all() else float(np.median(steps))

    def objection(self, column: int) -> str:
        """Say why a column holds no accelerations; empty if it may."""
        time = self.time()
        if time and column == time[0]:
            return f"is the time{self.header}"
        if step := self.rise(column):
            return f"rises from line to line in steps of {step:g}, as time or a count does"
        return ""

    def dt(self) -> float | None:
        """Find the sampling period in the header or the column of time, s; None: in neither.

        Raises
        ------
        InputError
            If the times do not increase evenly, within 1 % of the median step; names the line.
        """
        time = self.time()
        if time is None:
            return self.own_dt
        column, unit = time
        self.check_finite(column)
        times = self.values[:, column]
        steps = np.diff(times)
        typical = float(np.median(steps))
        uneven = np.flatnonzero((steps <= 0) | (np.abs(steps - typical) > _UNEVEN * typical))
        if uneven.size:
            row = int(uneven[0]) + 1
            raise InputError(
                f"{self.path}: line {self.lines[row]}: time goes from {times[row - 1]:g} to "
                f"{times[row]:g}, but its usual step is {typical:g}; resample the record evenly"
            )
        return float(f"{unit * (times[-1] - times[0]) / len(steps):.12g}")  # not 0.00500...1

    def check_finite(self, column: int) -> None:
        """Refuse a column with a NaN or an infinity; names the line."""
        bad = np.flatnonzero(~np.isfinite(self.values[:, column]))
        if bad.size:
            row = int(bad[0])
            raise InputError(
                f"{self.path}: line {self.lines[row]}: the value is {self.values[row, column]}, "
                "not a finite number; correct the record there, or cut it off before"
            )


def read_lines(path: Path) -> list[str]:
    """Read a text file, UTF-8 with any line ends; line n of it is item n - 1.

    Raises
    ------
    InputError
        If it can't be read, is empty, or is no text.
    """
    try:
        if path.is_dir():
            raise InputError(f"{path}: is a folder; give the record file in it")
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: is no regular file; give a record file")
        data = path.read_bytes()
    except FileNotFoundError:
        raise InputError(
            f"{path}: no such file; give its full path, or one from the working directory"
        ) from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: {getattr(error, 'strerror', None) or error}") from None
    bad = data.find(b"\0")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        bad = error.start
    if bad >= 0:
        raise InputError(
            f"{path}: line {data.count(b'\n', 0, bad) + 1}: byte 0x{data[bad]:02x} is no text; "
            "save the record as plain text (UTF-8)"
        )
    text = text.replace("\r\n", "\n").replace("\r", "\n").rstrip("\n\x1a")  # x1a: end in DOS
    if not text.strip():
        raise InputError(f"{path}: is empty; give a file that holds a record")
    return text.split("\n")


def is_comment(line: str) -> bool:
    """Whether a line begins with a comment mark."""
    return line.lstrip().startswith(_COMMENT_MARKS)


def to_float(token: str, path: Path, line: int) -> float:
    """Convert a piece of text to a number; it may overflow to infinity.

    Raises
    ------
    InputError
        If it is no number; names the file and the line.
    """
    if NUMBER.fullmatch(token):
        return float(token.upper().replace("D", "E"))
    if _NOT_FINITE.fullmatch(token):
        return float(token)
    if not token:
        raise InputError(f"{path}: line {line}: a field is empty; write a number there")
    shown = "".join(sign if sign.isprintable() else "?" for sign in token[:30])
    remedy = "correct it, or begin the line with % if it is a comment"
    if _DECIMAL_COMMA.fullmatch(token):
        remedy = "write decimal points, not commas"
    raise InputError(f'{path}: line {line}: "{shown}" is no number; {remedy}')


def read_unit(text: str) -> str | None:
    """Recognise an acceleration unit in any spelling, such as G, gal, cm/sec/sec, m/s^2.

    Returns a key of `UNITS`; None if the text is none of them.
    """
    word = text.strip().strip(".,;'").lower().replace("²", "2").replace(" ", "")
    word = re.sub(r"\*\*|\^", "", word).replace("sec", "s").replace("s/s", "s2")
    word = {"gal": "cm/s2", "gals": "cm/s2", "g's": "g", "gs": "g"}.get(word, word)
    return word if word in UNITS else None


def read_columns(path: Path, lines: list[str]) -> Columns:
    """Read the numbers of a file in columns.

    Comment lines (%, #, //, !, ;) and blank lines may be anywhere, lines of text above the data.

    Raises
    ------
    InputError
        If there is text in the data, or the number of columns changes; names the line.
    """
    start, separator = _find_data(path, lines)
    data = [
        (number, _fields(line, separator))
        for number, line in enumerate(lines[start:], start=start + 1)
        if line.strip() and not is_comment(line)
    ]
    count, rows = len(data[0][1]), []
    for number, fields in data:
        if len(fields) != count:
            what, remedy = "", "give all lines the same number of columns"
            if number == data[-1][0] and len(fields) < count:
                what = "a half-written last row: "
                remedy = "remove it, or fetch the record again"
            raise InputError(
                f"{path}: line {number}: {what}{len(fields)} columns, but {count} before; {remedy}"
            )
        rows.append([to_float(field, path, number) for field in fields])
    names: tuple[str, ...] = ()
    header = ""
    for number, line in enumerate(lines[:start], start=1):
        fields = _fields(line, separator)
        suspect = any(_is_number(field) or _LIKE_A_NUMBER.match(field) for field in fields)
        if len(fields) == count and suspect and not is_comment(line):
            for field in fields:
                to_float(field, path, number)
        if line.strip():
            header, names = f" (line {number})", _names(line, separator, count)
    units = [read_unit(word) for line in lines[:start] for word in _IN_UNIT.findall(line)]
    periods = [
        to_float(number, path, 1) * (1e-3 if milli else 1.0)
        for line in lines[:start]
        for number, milli in _DT.findall(line)
    ]
    return Columns(
        path,
        np.array(rows),
        [number for number, _ in data],
        names,
        header,
        next((period for period in periods if period > 0), None),
        next((unit for unit in units if unit), None),
    )


def _find_data(path: Path, lines: list[str]) -> tuple[int, str | None]:
    """Index of the first line of numbers only, and its separator (None: white space)."""
    candidate = None
    for index, line in enumerate(lines):
        if not line.strip() or is_comment(line):
            continue
        separator = ";" if ";" in line else "," if "," in line else None
        if _LONE_DECIMAL_COMMA.fullmatch(line.strip()):
            to_float(line.strip(), path, index + 1)
        if all(_is_number(field) for field in _fields(line, separator)):
            return index, separator
        if candidate is None and _LIKE_A_NUMBER.match(line.strip()):
            candidate = index, separator
    if candidate:
        for field in _fields(lines[candidate[0]], candidate[1]):
            to_float(field, path, candidate[0] + 1)
    raise InputError(f"{path}: contains no line of numbers; give a record in columns, or AT2")


def _fields(line: str, separator: str | None) -> list[str]:
    if separator is None:
        return line.split()
    return [field.strip() for field in line.strip().removesuffix(separator).split(separator)]


def _is_number(field: str) -> bool:
    return bool(NUMBER.fullmatch(field) or _NOT_FINITE.fullmatch(field))


def _names(line: str, separator: str | None, count: int) -> tuple[str, ...]:
    """Column names in a header line, if it splits into as many as there are columns."""
    text = line.strip()
    for mark in _COMMENT_MARKS:
        text = text.removeprefix(mark)
    text = text.strip()
    for fields in (
        re.split(r"\t+|\s{2,}", text),
        *(_fields(text, mark) for mark in (separator, ",", ";")),
    ):
        if len(fields) == count:
            return tuple(field.strip().strip("\"'").strip() for field in fields)
    return ()
