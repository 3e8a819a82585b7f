"""Any text with numbers: columns (white space, commas, semicolons), or one motion in rows."""

import csv
import re
from pathlib import Path

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError

from seft_ros.ground_motion.readers import columns, statements
from seft_ros.ground_motion.readers.record_text import (
    COMMENT_MARKS,
    is_comment,
    is_end_mark,
    is_number,
    to_float,
)

_OF_SPECTRUM = re.compile(r"\W*(?:natural\s+)?(?:period|freq(?:uency)?)(?![a-z])", re.I)
IN_COLUMNS = "columns"
IN_ROWS = "one motion in rows"

_LONE_DECIMAL_COMMA = re.compile(r"[+-]?\d+,0\d+")  # 0,005 would read as two columns
_WHOLE = re.compile(r"[+-]?\d+")
_LIKE_A_NUMBER = re.compile(r"[+-]?\.?\d")
_LONGEST_PERIOD = 0.1  # s
_FEWEST_COUNTED = 10
_FEWEST_IN_A_ROW = 4  # values; agencies write four to ten
_LONGEST_NAME = 3  # words; a longer one is a sentence
_UNEVEN_PAIRS = 0.5  # of a step
_LIKE = 4.0  # factor between mean squares of steps that are of one kind

_Rows = list[tuple[int, list[str]]]


def read_column_file(path: Path, lines: list[str], rows: bool) -> columns.Columns:
    """Read the numbers of a file, as columns or as one motion in rows.

    Comment lines (%, #, //, !, ;) and blank lines may be anywhere, lines of text above the data, an
    end mark below it. It is one motion in rows if ``rows`` or the header's number of points says
    so, or the last row of four or more columns is shorter and the values go on from row to row.

    Raises
    ------
    InputError
        If there is text in the data, the number of columns changes, the header contradicts the
        data or ``rows``; names the line.
    """
    start, separator = _find_data(path, lines)
    data = _data_rows(lines, start, separator)
    counted, data = _numeric_header(path, data)
    names, place, stated = _read_head(path, lines[:start], separator, data)
    header = _with(header=stated, counted=counted, path=path)
    has_unit = header.unit is not None or any(map(columns.named_unit, names))
    last = {fields[-1] for _, fields in data}
    if not has_unit or (len(last) > 1 and all(map(_WHOLE.fullmatch, last))):
        statements.check_factor(path, list(enumerate(lines[:start], start=1)))
    if _is_in_rows(path, data, header, rows):
        return _one_motion(path, data, header)
    if any(map(_OF_SPECTRUM.match, names)):
        what = "a spectrum, no time history; give the record of the acceleration"
        raise InputError(f"{path}: its columns are {', '.join(names)}{place}: {what}")
    values, says_so = _table(path, data), any(map(columns.says_acceleration, names))
    _check_pairs(path, values)
    places, texts = [number for number, _ in data], [fields for _, fields in data]
    known = names, place, header.dt, header.unit, texts
    sure = separator is not None and (says_so or bool(names and header.unit))
    return columns.Columns(path, values, places, IN_COLUMNS, *known, sure=sure)


def _find_data(path: Path, lines: list[str]) -> tuple[int, str | None]:
    """Index of the first line of numbers only, and its separator (None: white space)."""
    candidate = None
    for index, line in enumerate(lines):
        if not line.strip() or is_comment(line):
            continue
        marks = (";", ",", *(("\t",) if '"' in line else ()))
        separator = next((mark for mark in marks if mark in line), None)
        if _LONE_DECIMAL_COMMA.fullmatch(line.strip()):
            to_float(line.strip(), path, index + 1)
        if all(map(is_number, _fields(line, separator))):
            return index, separator
        if candidate is None and _LIKE_A_NUMBER.match(line.strip()):
            candidate = index, separator
    if candidate:
        for field in _fields(lines[candidate[0]], candidate[1]):
            to_float(field, path, candidate[0] + 1)
    raise InputError(f"{path}: contains no line of numbers; give a record, see docs/records.md")


def _data_rows(lines: list[str], start: int, separator: str | None) -> _Rows:
    """Split the lines of data, which end above an end mark."""
    end = len(lines)
    while end > start + 1 and is_end_mark(lines[end - 1]):
        end -= 1
    return [
        (number, _fields(line, separator))
        for number, line in enumerate(lines[start:end], start=start + 1)
        if line.strip() and not is_comment(line)
    ]


def _numeric_header(path: Path, data: _Rows) -> tuple[statements.Header, _Rows]:
    """Take off first lines that give the number of points, and perhaps the sampling period.

    They are ``4000 0.01`` or ``4000``, where so many values or rows follow.
    """
    first = [field for _, fields in data[:2] for field in fields]
    for lines, numbers in ((1, data[0][1]), (2, first)):
        others = data[lines:]
        if len(numbers) > 2 or not numbers[0].isdigit() or len(others) < 2:
            continue
        count, sizes = int(numbers[0]), (len(others), sum(len(fields) for _, fields in others))
        period = to_float(numbers[1], path, data[0][0]) if len(numbers) == 2 else None
        alone = period is None and len(others[0][1]) == 1
        if count < _FEWEST_COUNTED or count not in sizes:
            continue
        if alone or (period is not None and 0 < period <= _LONGEST_PERIOD):
            place = f"line {data[0][0]}"
            dt = statements.Statement(period, f"line {data[lines - 1][0]}") if period else None
            return statements.Header(None, dt, statements.Statement(count, place)), others
    return statements.Header(), data


def _read_head(
    path: Path, lines: list[str], separator: str | None, data: _Rows
) -> tuple[tuple[str, ...], str, statements.Header]:
    """Read the names of the columns, their place, and the statements of the lines above the data.

    The last of the lines has the names, if it splits into as many fields as there are columns. If
    white space separates these, it must not state anything: it may be a sentence.
    """
    count = len(data[0][1])
    numbered = [(number, line) for number, line in enumerate(lines, start=1) if line.strip()]
    for number, line in numbered:
        fields = _fields(line, separator)
        suspect = any(is_number(field) or _LIKE_A_NUMBER.match(field) for field in fields)
        suspect = suspect and statements.read_header(path, [(number, line)]) == statements.Header()
        if len(fields) == count and suspect and not is_comment(line):
            for field in fields:
                to_float(field, path, number)
    if not numbered:
        return (), "", statements.Header()
    last, line = numbered[-1]
    names, stated = _names(line, separator, count), statements.read_header(path, numbered[-1:])
    is_table = bool(separator) and count > 1 and not (stated.dt or stated.count)
    short = len(line.split()) <= _LONGEST_NAME and ":" not in line
    if count == 1 and not (short and columns.tells_quantity(line)):
        names = ()
    if names and (is_table or stated == statements.Header()):
        return names, f" (line {last})", statements.read_header(path, numbered[:-1])
    return (), f" (line {last})", statements.read_header(path, numbered)


def _with(
    *, header: statements.Header, counted: statements.Header, path: Path
) -> statements.Header:
    """Join the statements of words and of numbers above the data."""
    dt = statements.agreed(path, "sampling period, s,", header.dt, counted.dt)
    count = statements.agreed(path, "number of points", header.count, counted.count)
    return statements.Header(header.unit, dt, count)


def _is_in_rows(path: Path, data: _Rows, header: statements.Header, rows: bool) -> bool:
    """Decide whether the numbers are one motion in rows."""
    sizes = [len(fields) for _, fields in data]
    if header.count:
        count, total = header.count.value, sum(sizes)
        if count not in (len(data), total):
            raise InputError(
                f"{path}: {header.count.place} states {count} points, but {total} values follow in "
                f"{len(data)} rows; fetch the record again, or correct that line"
            )
        if rows and count != total:
            raise InputError(
                f"ground_motion: rows is true, but {path} says that it has {count} points, one in "
                "each row; leave rows (--rows) out"
            )
        return rows or (count == total and max(sizes) > 1)
    return rows or (
        len(data) > 2
        and len(set(sizes[:-1])) == 1
        and sizes[0] > sizes[-1]
        and sizes[0] >= _FEWEST_IN_A_ROW
        and goes_on(_table(path, data[:-1]))
    )


def goes_on(values: npt.NDArray[np.float64]) -> bool:
    """Whether values, shape (N, c), go on from the end of each row at the start of the next.

    Steps within rows and from row to row are then of one size, and smaller than those down a
    column, which are c samples apart.
    """
    within = np.mean(np.diff(values, axis=1) ** 2)
    between = np.mean((values[1:, 0] - values[:-1, -1]) ** 2)
    down = np.mean(np.diff(values, axis=0) ** 2)
    return bool(between < _LIKE * within and within < _LIKE * between and within < down)


def _one_motion(path: Path, data: _Rows, header: statements.Header) -> columns.Columns:
    places = [number for number, fields in data for _ in fields]
    values = [to_float(field, path, number) for number, fields in data for field in fields]
    table = np.array(values)[:, np.newaxis]
    sizes = {len(fields) for _, fields in data[:-1]}
    if len(sizes) == 1 and (wide := sizes.pop()) > 1:
        whole = np.reshape(values[: len(values) // wide * wide], (-1, wide))
        rows = columns.Columns(path, whole, places[::wide], IN_COLUMNS)
        for column in range(wide):
            if step := rows.rise(column):
                raise InputError(
                    f"{path}: column {column} rises from line to line in steps of {step:g}, as "
                    "time or a count does: it is not one motion in rows; leave rows (--rows) out"
                )
    return columns.Columns(path, table, places, IN_ROWS, (), "", header.dt, header.unit)


def _table(path: Path, data: _Rows) -> npt.NDArray[np.float64]:
    count, rows = len(data[0][1]), []
    if len(data) == 1 and count > 2:
        mend = "if they are one motion, set ground_motion rows (--rows)"
        raise InputError(f"{path}: holds one row of {count} numbers; {mend}")
    for number, fields in data:
        if len(fields) != count:
            remedy = "give all lines the same number of columns"
            if number == data[-1][0] and len(fields) < count:
                remedy = (
                    "if it is one motion in rows, set ground_motion rows (--rows); if not, the "
                    "record is cut off there: fetch it again"
                )
            found = f"{len(fields)} columns, but {count} before; {remedy}"
            raise InputError(f"{path}: line {number}: {found}")
        rows.append([to_float(field, path, number) for field in fields])
    return np.array(rows)


def _check_pairs(path: Path, values: npt.NDArray[np.float64]) -> None:
    """Refuse several pairs of time and value in each row: times then go on from pair to pair."""
    count, odd = divmod(values.shape[1], 2)
    if count < 2 or odd:
        return
    steps = np.diff(values[:, ::2].ravel())
    if (steps > 0).all() and np.ptp(steps) < _UNEVEN_PAIRS * np.median(steps):
        pairs = f"each row holds {count} pairs of time and value"
        raise InputError(f"{path}: {pairs}; write a pair to a line")


def _fields(line: str, separator: str | None) -> list[str]:
    if separator is None:
        return line.split()
    text = line.strip().removesuffix(separator)
    cut = text.split(separator)
    if '"' in text and len(text) < csv.field_size_limit():
        cut = next(csv.reader([text], delimiter=separator, skipinitialspace=True))
    return [field.strip() for field in cut]


def _names(line: str, separator: str | None, count: int) -> tuple[str, ...]:
    """Column names in a header line, if it splits into as many as there are columns."""
    text = line.strip()
    for mark in COMMENT_MARKS:
        text = text.removeprefix(mark)
    text = text.strip()
    ways = [_fields(text, separator)] if separator else []
    ways += [re.split(r"\t+|\s{2,}", text), re.split(r"\s+(?![\[(])", text)]
    ways += [_fields(text, mark) for mark in (None, ",", ";")]
    named = next((fields for fields in ways if len(fields) == count), [])
    return tuple(field.strip().strip("\"'").strip() for field in named)
