"""Recorded ground motions, from agencies' files and files in columns."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError

from seft_ros.ground_motion.agency_file import read_agency_file
from seft_ros.ground_motion.column_file import UNITS, Columns, read_columns, read_lines

_SAME_DT = 1e-3

FIRST_MOTION = -1
"""Column that stands for the first that is not the time."""


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
        Unit of the values, ``g``, ``m/s2`` or ``cm/s2``; empty: the one that the file's header
        says. Where the file says one, the two must agree.
    dt : float
        Sampling period in s; 0: the file's own, of its header (AT2, or text such as ``dt=0.005``)
        or of a column of time. Where the file has one, the two must agree within 0.1 %.

    Raises
    ------
    InputError
        If the file can't be read as a record, names the line; or if column, unit or dt do
        not fit the file.
    """
    path = Path(path)
    lines = read_lines(path)
    file = read_agency_file(path, lines) or read_columns(path, lines)
    columns = [file.first_motion() if column == FIRST_MOTION else column for column in columns]
    _check_columns(file, columns, unit)
    units = [unit or file.unit(column) for column in columns]
    for column, found in zip(columns, units, strict=True):
        if found is None:
            largest = float(np.abs(file.values[:, column]).max())
            raise InputError(
                f"{path}: does not say the unit of its accelerations, of which the largest is "
                f"{largest:.4g}; set ground_motion unit (--unit) to {', '.join(UNITS)}"
            )
    own_dt = file.dt()
    if own_dt is None and not dt:
        raise InputError(f"{path}: holds no sampling period; set ground_motion dt (--dt), in s")
    if own_dt and dt and abs(dt - own_dt) > _SAME_DT * own_dt:
        raise InputError(
            f"ground_motion: dt is {dt:g} s, but {path} says {own_dt:g} s; "
            "leave dt out to take the file's"
        )
    with np.errstate(over="ignore"):
        sizes = [UNITS[found] for found in units if found]
        accelerations = np.ascontiguousarray(file.values[:, columns]) * np.array(sizes)
    return RecordedMotion(accelerations, float(dt or own_dt or 0), str(path), units[0] or "")


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
        if unit and found not in (None, unit):
            raise InputError(
                f"ground_motion: unit is {unit}, but the header{line} of {file.path} says {found}; "
                f"set unit to {found}"
            )
        if time and column == time[0]:
            why = f"is the time{line}"
        elif count > 1 and (step := file.rise(column)):
            why = f"rises from line to line in steps of {step:g}, as time or a count does"
        else:
            continue
        raise InputError(
            f"ground_motion: column is {column}, but that column of {file.path} {why}; "
            f"choose another, 0 to {count - 1}"
        )
