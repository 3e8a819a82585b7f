"""Recorded ground motions, from PEER AT2 files and files in columns."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError

from seft_ros.ground_motion.column_file import ColumnFile, read_columns
from seft_ros.ground_motion.peer_at2 import is_at2, read_at2
from seft_ros.ground_motion.text_file import not_finite, read_lines
from seft_ros.ground_motion.time_column import named_time_column, ramp_step, time_step
from seft_ros.ground_motion.units import UNITS, unit_of_name

Floats = npt.NDArray[np.float64]
_SAME_DT = 1e-3


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

    Returns
    -------
    RecordedMotion
        In m/s^2.

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
    read = _from_at2 if is_at2(path, lines) else _from_columns
    values, own_dt = read(path, lines, columns, unit)
    if own_dt is None and not dt:
        raise InputError(f"{path}: holds no sampling period; set ground_motion dt")
    if own_dt and dt and abs(dt - own_dt) > _SAME_DT * own_dt:
        raise InputError(
            f"ground_motion: dt is {dt:g} s, but {path} says {own_dt:g} s; "
            "leave dt out to take the file's"
        )
    with np.errstate(over="ignore"):
        accelerations = np.ascontiguousarray(values) * UNITS[unit]
    return RecordedMotion(accelerations, float(dt or own_dt or 0), str(path))


def _from_at2(
    path: Path, lines: list[str], columns: Sequence[int], unit: str
) -> tuple[Floats, float | None]:
    record = read_at2(path, lines)
    values = record.values[:, np.newaxis]
    _check_shape(path, values, columns)
    _check_unit(path, "the header", record.unit, unit)
    return values[:, list(columns)], record.dt


def _from_columns(
    path: Path, lines: list[str], columns: Sequence[int], unit: str
) -> tuple[Floats, float | None]:
    file = read_columns(path, lines)
    _check_shape(path, file.values, columns)
    where = f"the header (line {file.header_line})"
    for column in columns:
        values = file.values[:, column]
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise not_finite(values[bad[0]], path, file.line_of(int(bad[0])))
        if file.names:
            _check_unit(path, where, unit_of_name(file.names[column]), unit)
    time = named_time_column(file.names)
    _refuse_time(path, file, columns, time)
    return file.values[:, list(columns)], time_step(path, file, *time) if time else None


def _check_shape(path: Path, values: Floats, columns: Sequence[int]) -> None:
    count = values.shape[1]
    if not columns or not all(0 <= column < count for column in columns):
        holds = f"{count} columns, 0 to {count - 1}" if count > 1 else "one column, 0"
        raise InputError(f"ground_motion: column is {list(columns)}, but {path} has {holds}")
    if len(values) < 2:
        raise InputError(f"{path}: holds one sample only; a record needs two at least")


def _check_unit(path: Path, where: str, found: str | None, unit: str) -> None:
    if found not in (None, unit):
        raise InputError(
            f"ground_motion: unit is {unit}, but {where} of {path} says {found}; "
            f"set unit to {found}"
        )


def _refuse_time(
    path: Path, file: ColumnFile, columns: Sequence[int], time: tuple[int, float] | None
) -> None:
    """Refuse to take the column of time for accelerations, named or not."""
    count = file.values.shape[1]
    for column in columns:
        if time is not None and column == time[0]:
            why = f"is the time (line {file.header_line})"
        elif time is None and count > 1 and (step := ramp_step(file.values[:, column])):
            why = f"rises evenly in steps of {step:g} as time does"
        else:
            continue
        raise InputError(
            f"ground_motion: column is {column}, but that column of {path} {why}; "
            f"choose another, 0 to {count - 1}"
        )
