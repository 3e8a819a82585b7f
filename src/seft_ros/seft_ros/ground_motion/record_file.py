"""Recorded ground motions: PEER AT2, COSMOS V1 and V2, SMC of the USGS, files in columns.

AT2 has two header dialects, ``4096    0.0100    NPTS, DT`` and ``NPTS=  4096, DT= .01000 SEC``.
COSMOS (v1.20) has lines with the number and the format of the values that follow. SMC has headers
of fixed length. In all of them the values follow row by row; the last line may be shorter.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError

from seft_ros.ground_motion.column_file import (
    NUMBER,
    UNITS,
    Columns,
    is_comment,
    read_columns,
    read_lines,
    read_unit,
    to_float,
)

_HEADER_LINES = 50
_NPTS = re.compile(r"\bNPTS\b", re.IGNORECASE)
_UNIT = re.compile(
    r"\bUNITS?\s*(?:OF\b|IN\b|:|=|[\[(])\s*[\[(]?\s*([A-Z][^\s,;()\[\]]*)", re.IGNORECASE
)
_OTHER_QUANTITY = re.compile(r"\b(VELOCITY|DISPLACEMENT)\s+TIME\b", re.IGNORECASE)
_RUN_TOGETHER = re.compile(r"(?<=[0-9.])(?=[+-])")

_FORMAT = r"Format\s*=\s*\(\s*(?:1P)?\d*[DEFGI](\d+)"
_COSMOS = re.compile(
    rf"^\s*(\d+)\s+(\w+)\s+pts\b.*?\bunits\s*=\s*([^,(]+).*?{_FORMAT}", re.IGNORECASE | re.ASCII
)
_REAL_HEADER = re.compile(
    rf"^\s*\d+\s+Real-header values follow on\s+(\d+)\s+lines.*?{_FORMAT}",
    re.IGNORECASE | re.ASCII,
)
_COSMOS_PERIODS = ((62, 1e-3), (34, 1.0))
"""Places of the sampling period in the real header, and its unit in s: the period of these values,
then that of the instrument."""

_SMC = re.compile(r"^\s*[0-9]\s+(?:UN)?CORRECTED\s+ACCELEROGRAM\b", re.IGNORECASE)
_SMC_TEXT, _SMC_INTEGERS, _SMC_REALS = 11, 6, 10  # lines
_SMC_COMMENTS, _SMC_COUNT, _SMC_RATE = 15, 16, 1  # places, from 0


def read_agency_file(path: Path, lines: list[str]) -> Columns | None:
    """Read a record in an agency's format; None: it is in none of them.

    AT2 files are known by the NPTS line of their header, or by their name; SMC and COSMOS files by
    their headers.

    Raises
    ------
    InputError
        If the header can't be understood or is not that of an acceleration, or if the number of
        values is not that of the header.
    """
    if any(_COSMOS.match(line) for line in lines):
        return _read_cosmos(path, lines)
    if _SMC.match(lines[0]):
        return _read_smc(path, lines)
    header = enumerate(lines[:_HEADER_LINES])
    end = next((n for n, line in header if _NPTS.search(line) and not is_comment(line)), None)
    if end is not None or path.suffix.lower() == ".at2":
        return _read_at2(path, lines, end)
    return None


def _read_at2(path: Path, lines: list[str], end: int | None) -> Columns:
    """Read an AT2 file: one column, in the header's unit and with its DT."""
    if end is None:
        raise InputError(
            f"{path}: no header line gives NPTS and DT; an AT2 record needs one, "
            "a file of plain columns must not be named .at2"
        )
    numbers = NUMBER.findall(lines[end])
    if len(numbers) < 2 or not numbers[0].isdigit():
        raise InputError(
            f"{path}: line {end + 1}: NPTS without a count and a DT; "
            'expected "NPTS= 4096, DT= .0100 SEC" or "4096 0.0100 NPTS, DT"'
        )
    count, dt = int(numbers[0]), to_float(numbers[1], path, end + 1)
    if count < 1 or not 0 < dt < np.inf:
        raise InputError(
            f"{path}: line {end + 1}: NPTS is {count} and DT is {dt:g} s; both must be positive"
        )
    unit = None
    for number, line in enumerate(lines[: end + 1], start=1):
        if unit is None and (other := _OTHER_QUANTITY.search(line)):
            raise _other_quantity(path, number, other.group(1))
        if unit is None and (stated := _UNIT.search(line)):
            unit = _known_unit(path, number, stated.group(1))
    return _one_column(path, lines, end, count, dt, unit)


def _read_smc(path: Path, lines: list[str]) -> Columns:
    """Read an SMC file: one column, in cm/s^2."""
    reals = _SMC_TEXT + _SMC_INTEGERS
    end = reals + _SMC_REALS
    integers = _fields(path, lines, _SMC_TEXT, reals, 10)
    numbers = _fields(path, lines, reals, end, 15)
    if len(integers) <= _SMC_COUNT or len(numbers) <= _SMC_RATE or not numbers[_SMC_RATE] > 0:
        raise InputError(
            f"{path}: the header of an SMC record gives no count of values and no rate; fetch the "
            "record again"
        )
    end += max(int(integers[_SMC_COMMENTS]), 0)
    dt = float(f"{1 / numbers[_SMC_RATE]:.7g}")
    return _one_column(path, lines, end - 1, int(integers[_SMC_COUNT]), dt, "cm/s2", _SMC_TEXT + 2)


def _read_cosmos(path: Path, lines: list[str]) -> Columns:
    """Read a COSMOS file: a column for each of its channels of acceleration.

    Velocities and displacements, which may follow each channel, are left out.
    """
    found, other, dt = list[Columns](), "", None
    for index, line in enumerate(lines):
        if real := _REAL_HEADER.match(line):
            end = index + 1 + int(real.group(1))
            numbers = _fields(path, lines, index + 1, end, int(real.group(2)))
            known = [
                float(f"{numbers[place - 1] * unit:.7g}")
                for place, unit in _COSMOS_PERIODS
                if len(numbers) >= place and numbers[place - 1] > 0
            ]
            dt = known[0] if known else None
        elif data := _COSMOS.match(line):
            if data.group(2).lower() != "acceleration":
                other = other or data.group(2)
                continue
            unit = _known_unit(path, index + 1, data.group(3).strip())
            count, width = int(data.group(1)), int(data.group(4))
            lasts = range(index + 1, len(lines))
            end = next((n for n in lasts if not _is_row(lines[n])), len(lines))
            found.append(_one_column(path, lines[:end], index, count, dt, unit, width=width))
    if not found:
        raise _other_quantity(path, 1, other)
    first = found[0]
    if any(c.values.shape != first.values.shape or c.own_dt != first.own_dt for c in found):
        raise InputError(
            f"{path}: its channels differ in length or sampling period; save each as a file"
        )
    columns = np.hstack([channel.values for channel in found])
    return Columns(path, columns, first.lines, own_dt=first.own_dt, own_unit=first.own_unit)


def _is_row(line: str) -> bool:
    return not line.strip() or not line.strip()[0].isalpha()


def _one_column(
    path: Path,
    lines: list[str],
    end: int,
    count: int,
    dt: float | None,
    unit: str | None,
    said: int = 0,
    width: int = 0,
) -> Columns:
    """Read the values below a header's last line, of index ``end``; the header gives their number.

    ``said`` is the number of the line with the number of values, if it is another line. With a
    ``width`` each value has so many characters; otherwise blanks or signs separate the values.
    """
    values = [
        (to_float(piece.strip(), path, number), number)
        for number, line in enumerate(lines[end + 1 :], start=end + 2)
        for piece in _pieces(line, width)
    ]
    if len(values) != count or not values:
        what = "the file is truncated" if len(values) < count else "too many"
        raise InputError(
            f"{path}: line {said or end + 1} says {count} values, but {len(values)} values follow: "
            f"{what}; fetch the record again, or correct that line"
        )
    numbers, places = zip(*values, strict=True)
    return Columns(path, np.array([numbers]).T, list(places), own_dt=dt, own_unit=unit)


def _pieces(line: str, width: int) -> Iterable[str]:
    if width:
        text = line.rstrip()
        return (text[at : at + width] for at in range(0, len(text), width))
    return (piece for token in line.split() for piece in _RUN_TOGETHER.split(token))


def _fields(path: Path, lines: list[str], start: int, end: int, width: int) -> list[float]:
    """Read the numbers of a header with a fixed width for each number."""
    numbers = []
    for number, line in enumerate(lines[start:end], start=start + 1):
        numbers += [to_float(piece.strip(), path, number) for piece in _pieces(line, width)]
        if not np.isfinite(numbers).all():
            raise InputError(f"{path}: line {number}: a number is not finite; correct it")
    return numbers


def _known_unit(path: Path, number: int, text: str) -> str:
    unit = read_unit(text)
    if unit is None:
        raise InputError(
            f"{path}: line {number}: {text} is no acceleration unit known here; convert the "
            "record to g, m/s2 or cm/s2"
        )
    return unit


def _other_quantity(path: Path, number: int, quantity: str) -> InputError:
    return InputError(
        f"{path}: line {number}: holds a {quantity.lower()}; give the record of the acceleration"
    )


_SAME_DT = 1e-3

FIRST_MOTION = -1
"""Means the first column that is not the time."""


@dataclass(frozen=True)
class RecordedMotion:
    """A recorded ground motion.

    Attributes
    ----------
    accelerations : ndarray
        Shape (N, c): samples, chosen columns; m/s^2, finite; N is at least 2.
    dt : float
        Sampling period of the record in s.
    source : str
        Its file.
    unit : str
        Unit of the accelerations in the file, of the first chosen column.
    """

    accelerations: npt.NDArray[np.float64]
    dt: float
    source: str
    unit: str


def read_record(
    path: str | Path, columns: Sequence[int], unit: str = "", dt: float = 0.0
) -> RecordedMotion:
    """Read a recorded ground motion.

    Files of agencies are known by their headers, see `read_agency_file`; any other file is read
    as columns of numbers (white space, commas or semicolons), with comment lines (%, #, //, !, ;)
    and lines of text above the data.

    Parameters
    ----------
    path : str or Path
        The file.
    columns : sequence of int
        Columns to take, counted from 0; one may be taken several times; `FIRST_MOTION` is the
        first that is not the time.
    unit : str
        Unit of the values, ``g``, ``m/s2`` or ``cm/s2``; empty: the unit that the file's header
        states. If the file states one, the two must agree.
    dt : float
        Sampling period in s; 0: that of the file's header (AT2, or text such as ``dt=0.005``) or
        column of time. If the file has one, the two must agree within 0.1 %.

    Raises
    ------
    InputError
        If the file can't be read as a record (names the line), or if column, unit or dt contradict
        the file.
    """
    path = Path(path)
    lines = read_lines(path)
    file = read_agency_file(path, lines) or read_columns(path, lines)
    first = next((c for c in range(file.values.shape[1]) if not file.objection(c)), 0)
    columns = [first if column == FIRST_MOTION else column for column in columns]
    _check_columns(file, columns)
    units = [_unit_of(file, column, unit) for column in columns]
    own_dt = file.dt()
    if own_dt is None and not dt:
        raise InputError(f"{path}: states no sampling period; set ground_motion dt (--dt), in s")
    if own_dt and dt and abs(dt - own_dt) > _SAME_DT * own_dt:
        raise InputError(
            f"ground_motion: dt is {dt:g} s, but {path} says {own_dt:g} s; "
            "leave dt out to take the file's"
        )
    with np.errstate(over="ignore"):
        sizes = np.array([UNITS[found] for found in units])
        accelerations = np.ascontiguousarray(file.values[:, columns]) * sizes
    return RecordedMotion(accelerations, float(dt or own_dt or 0), str(path), units[0])


def _check_columns(file: Columns, columns: Sequence[int]) -> None:
    """Refuse columns that do not exist, are not finite, or contain the time."""
    rows, count = file.values.shape
    if not columns or not all(0 <= column < count for column in columns):
        holds = f"{count} columns, 0 to {count - 1}" if count > 1 else "one column, 0"
        raise InputError(f"ground_motion: column is {list(columns)}, but {file.path} has {holds}")
    if rows < 2:
        raise InputError(f"{file.path}: holds one sample only; a record needs two at least")
    for column in columns:
        file.check_finite(column)
        if why := file.objection(column):
            raise InputError(
                f"ground_motion: column is {column}, but that column of {file.path} {why}; "
                f"choose another, 0 to {count - 1}"
            )


def _unit_of(file: Columns, column: int, unit: str) -> str:
    """Give the unit of a column; the file's and the given one must agree, and one be there."""
    stated = file.unit(column)
    if unit and stated not in (None, unit):
        raise InputError(
            f"ground_motion: unit is {unit}, but the header{file.header} of {file.path} says "
            f"{stated}; set unit to {stated}"
        )
    if found := unit or stated:
        return found
    largest = float(np.abs(file.values[:, column]).max())
    raise InputError(
        f"{file.path}: does not say the unit of its accelerations, of which the largest is "
        f"{largest:.4g}; set ground_motion unit (--unit) to {', '.join(UNITS)}"
    )
