"""Recorded ground motions, from PEER AT2 files and files in columns.

AT2 has two header dialects, ``4096    0.0100    NPTS, DT`` and ``NPTS=  4096, DT= .01000 SEC``.
The values follow row by row, as many to a line as fit; the last line may be shorter.
"""

import re
from collections.abc import Sequence
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
_NAME_FIRST = re.compile(
    rf"\bNPTS\s*[=:]?\s*(\d+)[\s,;]*DT\s*[=:]?\s*({NUMBER.pattern})", re.IGNORECASE | re.ASCII
)
_NUMBER_FIRST = re.compile(
    rf"^\s*(\d+)[\s,;]+({NUMBER.pattern})[\s,;]*NPTS[\s,;]*DT\b", re.IGNORECASE | re.ASCII
)
_UNIT = re.compile(
    r"\bUNITS?\s*(?:OF\b|IN\b|:|=|[\[(])\s*[\[(]?\s*([A-Z][^\s,;()\[\]]*)", re.IGNORECASE
)
_OTHER_QUANTITY = re.compile(r"\b(VELOCITY|DISPLACEMENT)\s+TIME\b", re.IGNORECASE)
_RUN_TOGETHER = re.compile(r"(?<=[0-9.])(?=[+-])")


_SAME_DT = 1e-3
_RAMP_ROWS = 10
_RAMP_STEP = 0.1  # s; records are sampled faster
_UNEVEN = 0.01  # of a step


@dataclass(frozen=True)
class RecordedMotion:
    """A ground motion as it was recorded.

    Attributes
    ----------
    accelerations : ndarray
        Shape (N, c): samples, chosen columns; m/s^2, finite; N is at least 2.
    dt : float
        Sampling period of the record in s.
    source : str
        File it was read from.
    """

    accelerations: npt.NDArray[np.float64]
    dt: float
    source: str


def read_record(
    path: str | Path, columns: Sequence[int], unit: str, dt: float = 0.0
) -> RecordedMotion:
    """Read a recorded ground motion.

    AT2 files are known by the NPTS line of their header, or by their name; any other file is
    read as columns of numbers (white space, commas or semicolons), with comment lines (%, #,
    //, !, ;) and lines of text above the data.

    Parameters
    ----------
    path : str or Path
        The file.
    columns : sequence of int
        Columns to take, counted from 0; one may be taken several times.
    unit : str
        Unit of the values: ``g``, ``m/s2`` or ``cm/s2``.
    dt : float
        Sampling period in s; 0 takes the file's own (AT2 header, or a column whose header
        says time). Where the file has one, the two must agree within 0.1 %.

    Raises
    ------
    InputError
        If the file can't be read as a record, names the line; or if column, unit or dt do
        not fit the file.
    """
    path = Path(path)
    lines = read_lines(path)
    header = _header_end(lines)
    is_at2 = header is not None or path.suffix.lower() == ".at2"
    file = _read_at2(path, lines, header) if is_at2 else read_columns(path, lines)
    _check_columns(file, columns, unit)
    own_dt = file.dt()
    if own_dt is None and not dt:
        raise InputError(f"{path}: holds no sampling period; set ground_motion dt")
    if own_dt and dt and abs(dt - own_dt) > _SAME_DT * own_dt:
        raise InputError(
            f"ground_motion: dt is {dt:g} s, but {path} says {own_dt:g} s; "
            "leave dt out to take the file's"
        )
    with np.errstate(over="ignore"):
        accelerations = np.ascontiguousarray(file.values[:, list(columns)]) * UNITS[unit]
    return RecordedMotion(accelerations, float(dt or own_dt or 0), str(path))


def _check_columns(file: Columns, columns: Sequence[int], unit: str) -> None:
    """Refuse columns that do not exist, hold no numbers, have another unit, or hold the time."""
    rows, count = file.values.shape
    if not columns or not all(0 <= column < count for column in columns):
        holds = f"{count} columns, 0 to {count - 1}" if count > 1 else "one column, 0"
        raise InputError(f"ground_motion: column is {list(columns)}, but {file.path} has {holds}")
    if rows < 2:
        raise InputError(f"{file.path}: holds one sample only; a record needs two at least")
    line = f" (line {file.header_line})" if file.header_line else ""
    time = file.time()
    for column in columns:
        file.check_finite(column)
        found = file.unit(column)
        if found not in (None, unit):
            raise InputError(
                f"ground_motion: unit is {unit}, but the header{line} of {file.path} says {found}; "
                f"set unit to {found}"
            )
        if time and column == time[0]:
            why = f"is the time{line}"
        elif not time and count > 1 and (step := _ramp(file.values[:, column])):
            why = f"rises evenly in steps of {step:g} as time does"
        else:
            continue
        raise InputError(
            f"ground_motion: column is {column}, but that column of {file.path} {why}; "
            f"choose another, 0 to {count - 1}"
        )


def _ramp(values: npt.NDArray[np.float64]) -> float | None:
    """Step of values that rise evenly from zero as time does; None: they are no times."""
    if len(values) < _RAMP_ROWS:
        return None
    steps = np.diff(values)
    step = float(values[-1] - values[0]) / len(steps)
    if not 0 < step <= _RAMP_STEP or np.abs(steps - step).max() > _UNEVEN * step:
        return None
    return step if abs(values[0]) <= (1 + _UNEVEN) * step else None


def _read_at2(path: Path, lines: list[str], end: int | None) -> Columns:
    """Read an AT2 file: one column, in the header's unit and with its DT.

    Raises
    ------
    InputError
        If the header can't be understood or is not that of an acceleration, or if there are not
        as many values as NPTS says.
    """
    if end is None:
        raise InputError(
            f"{path}: no header line gives NPTS and DT; an AT2 record needs one, "
            "a file of plain columns must not be named .at2"
        )
    found = _NAME_FIRST.search(lines[end]) or _NUMBER_FIRST.search(lines[end])
    if found is None:
        raise InputError(
            f"{path}: line {end + 1}: NPTS without a count and a DT; "
            'expected "NPTS= 4096, DT= .0100 SEC" or "4096 0.0100 NPTS, DT"'
        )
    count, dt = int(found.group(1)), to_float(found.group(2), path, end + 1)
    if count < 1 or not 0 < dt < np.inf:
        raise InputError(
            f"{path}: line {end + 1}: NPTS is {count} and DT is {dt:g} s; both must be positive"
        )
    unit = _header_unit(path, lines[: end + 1])
    values = [
        (to_float(piece, path, number), number)
        for number, line in enumerate(lines[end + 1 :], start=end + 2)
        for token in line.split()
        for piece in _RUN_TOGETHER.split(token)
    ]
    if len(values) != count:
        what = "the file is truncated" if len(values) < count else "that is too many"
        raise InputError(
            f"{path}: line {end + 1} says NPTS {count}, but {len(values)} values follow: {what}; "
            "fetch the record again, or correct NPTS"
        )
    numbers, places = zip(*values, strict=True)
    names = () if unit is None else (f"acceleration ({unit})",)
    return Columns(path, np.array([numbers]).T, list(places), names, own_dt=dt)


def _header_end(lines: list[str]) -> int | None:
    """Index of the line with NPTS, which is the header's last."""
    for index, line in enumerate(lines[:_HEADER_LINES]):
        if _NPTS.search(line) and not is_comment(line):
            return index
    return None


def _header_unit(path: Path, header: list[str]) -> str | None:
    for number, line in enumerate(header, start=1):
        if other := _OTHER_QUANTITY.search(line):
            raise InputError(
                f"{path}: line {number}: holds a {other.group(1).lower()}; "
                "give the acceleration record (.AT2)"
            )
        if found := _UNIT.search(line):
            unit = read_unit(found.group(1))
            if unit is None:
                raise InputError(
                    f"{path}: line {number}: {found.group(1)} is no acceleration unit known "
                    "here; convert the record to g, m/s2 or cm/s2"
                )
            return unit
    return None
