"""Recorded ground motions, from PEER AT2 files and files in columns."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError

from seft_ros.ground_motion.column_file import Columns, read_columns
from seft_ros.ground_motion.peer_at2 import is_at2, read_at2
from seft_ros.ground_motion.text_file import UNITS, read_lines

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
    if unit not in UNITS:
        raise InputError(f"ground_motion: unit is {unit}, but must be one of {', '.join(UNITS)}")
    if not 0 <= dt < np.inf:
        raise InputError(f"ground_motion: dt is {dt} s, but must be positive, or 0 (the file's)")
    lines = read_lines(path)
    file = read_at2(path, lines) if is_at2(path, lines) else read_columns(path, lines)
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
    """Refuse columns that are none, hold no numbers, are in another unit, or hold the time."""
    rows, count = file.values.shape
    if not columns or not all(0 <= column < count for column in columns):
        holds = f"{count} columns, 0 to {count - 1}" if count > 1 else "one column, 0"
        raise InputError(f"ground_motion: column is {list(columns)}, but {file.path} has {holds}")
    if rows < 2:
        raise InputError(f"{file.path}: holds one sample only; a record needs two at least")
    for column in columns:
        file.check_finite(column)
        found = file.units[column]
        if found not in (None, unit):
            raise InputError(
                f"ground_motion: unit is {unit}, but {file.header} of {file.path} says {found}; "
                f"set unit to {found}"
            )
    time = file.time and file.time[0]
    for column in columns:
        if column == time:
            why = f"is the time (line {file.header_line})"
        elif time is None and count > 1 and (step := _ramp(file.values[:, column])):
            why = f"rises evenly in steps of {step:g} as time does"
        else:
            continue
        raise InputError(
            f"ground_motion: column is {column}, but that column of {file.path} {why}; "
            f"choose another, 0 to {count - 1}"
        )


def _ramp(values: npt.NDArray[np.float64]) -> float | None:
    """Step of values that rise evenly from zero as time does, and no acceleration; or None."""
    if len(values) < _RAMP_ROWS:
        return None
    steps = np.diff(values)
    step = float(values[-1] - values[0]) / len(steps)
    if not 0 < step <= _RAMP_STEP or np.abs(steps - step).max() > _UNEVEN * step:
        return None
    return step if abs(values[0]) <= (1 + _UNEVEN) * step else None
