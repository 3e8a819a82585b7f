"""A recorded ground motion: the columns that a test uses, in m/s^2, with unit and period.

What is taken from a file, and where its unit and period come from, is known and shown. What the
user says must not contradict the file.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError

from seft_ros.ground_motion.readers.agency_files import AGENCY_FORMATS, check_name
from seft_ros.ground_motion.readers.column_file import read_column_file
from seft_ros.ground_motion.readers.columns import Columns
from seft_ros.ground_motion.readers.record_text import read_bytes, to_lines
from seft_ros.ground_motion.readers.seismological import read_knet, read_miniseed, read_sac
from seft_ros.ground_motion.readers.statements import (
    GIVEN_UNITS,
    UNITS,
    Statement,
    is_same_period,
    read_unit,
    stated_peaks,
)


def read_file(path: Path, rows: bool = False, response: str = "") -> Columns:
    """Read a record in any format.

    Parameters
    ----------
    path : Path
        The file.
    rows : bool
        Text that is in no agency's format is one motion in rows.
    response : str
        File of the station's metadata, for SAC and miniSEED; empty: none.

    Raises
    ------
    InputError
        If the file can't be read, or is no record.
    """
    data = read_bytes(path)
    for of_bytes in (read_sac, read_miniseed):
        if (columns := of_bytes(path, data, response)) is not None:
            return columns
    lines = to_lines(path, data)
    for of_text in (read_knet, *AGENCY_FORMATS):
        if (columns := of_text(path, lines)) is not None:
            break
    else:
        if not rows:
            check_name(path)
        columns = read_column_file(path, lines, rows)
    return replace(columns, peaks=stated_peaks(path, lines))


FIRST_MOTION = -1
"""Means the column that the names tell, or the first that is not the time."""

_GIVEN = "as given"
_LONGEST_PERIOD = 1.0  # s; a longer one is in another unit


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
        Name of its file, without the folder.
    unit : str
        Unit of the accelerations in the file, of the first chosen column.
    channels : list of dict
        What was read, for each column: ``file`` (name without its folder), ``layout`` (how the
        file was read), ``column`` (number and name), ``unit``, ``unit_from``, ``dt_s``,
        ``dt_from``, ``samples``.
    """

    accelerations: npt.NDArray[np.float64]
    dt: float
    source: str
    unit: str
    channels: list[dict[str, Any]] = field(default_factory=list)


def read_record(
    path: str | Path,
    columns: Sequence[int],
    unit: str = "",
    dt: float = 0.0,
    *,
    rows: bool = False,
    response: str = "",
    corrected: bool = False,
) -> RecordedMotion:
    """Read a recorded ground motion.

    Files of agencies are known by their headers, see `AGENCY_FORMATS`; any other text is read as
    columns of numbers or one motion in rows, see `column_file`.

    Parameters
    ----------
    path : str or Path
        The file.
    columns : sequence of int
        Columns to take, counted from 0; one may be taken several times; `FIRST_MOTION` is the
        one that its name says is an acceleration, or the first that is not the time.
    unit : str
        Unit of the values, ``g``, ``m/s2`` or ``cm/s2`` in any spelling, such as gal; empty: the
        unit that the file states. If the file states one, the two must agree.
    dt : float
        Sampling period in s; 0: that of the file's header or column of time. If the file has one,
        the two must agree within 0.1 %.
    rows : bool
        The numbers are one motion in rows.
    response : str
        File of the station's metadata, for counts in SAC and miniSEED files.
    corrected : bool
        The mean is taken off later: an offset does no harm.

    Raises
    ------
    InputError
        If the file can't be read as a record (names the line), or if column, unit, dt or rows
        contradict the file, or what is read the peak that it states; see `Columns.check_offset`.
    """
    path, given = Path(path), given_unit(unit)
    file = read_file(path, rows, response)
    columns = [file.default() if column == FIRST_MOTION else column for column in columns]
    _check_columns(file, columns)
    units = [_unit_of(file, column, given) for column in columns]
    period = _period_of(file, dt)
    with np.errstate(over="ignore"):
        sizes = np.array([UNITS[found.value] for found in units])
        count = file.count(columns[0])
        accelerations = np.ascontiguousarray(file.values[:count, columns]) * sizes
        for column, motion in zip(columns, accelerations.T, strict=True):
            file.check_offset(column, motion, corrected=corrected)
    channels = [
        {
            "file": path.name,
            "layout": file.layout,
            "column": file.called(column),
            "unit": found.value,
            "unit_from": found.place,
            "dt_s": period.value,
            "dt_from": period.place,
            "samples": len(accelerations),
        }
        for column, found in zip(columns, units, strict=True)
    ]
    return RecordedMotion(accelerations, period.value, path.name, units[0].value, channels)


def files_of(file: str | Sequence[str], axes: Sequence[str]) -> list[str]:
    """Give the records that the parameter ``file`` names; none: the motion is synthetic.

    Several are in the order of ``axes``, or each is ``AXIS=FILE``.

    Raises
    ------
    InputError
        If one of several is empty; if there is not one for each axis, where axes are named.
    """
    files = [file] if isinstance(file, str) else list(file)
    if len(files) > 1 and not all(files):
        need = "a record for each axis must be named"
        raise InputError(f"ground_motion: file is {files}, but {need}")
    by_axis = {axis: name for axis, mark, name in (each.partition("=") for each in files) if mark}
    if by_axis.keys().isdisjoint(axes):
        return [name for name in files if name]
    if sorted(by_axis) != sorted(axes) or len(files) != len(axes):
        need = f"must be AXIS=FILE for each axis of [{', '.join(axes)}], once"
        raise InputError(f"ground_motion: file is {files}, but {need}")
    return [by_axis[axis] for axis in axes]


def source_name(file: str | Sequence[str]) -> str:
    """Name the records of the parameter ``file``, without their folders; empty: none."""
    return ", ".join(Path(name).name for name in files_of(file, ()))


def _check_columns(file: Columns, columns: Sequence[int]) -> None:
    """Refuse columns that do not exist, are not finite, or contain the time."""
    rows, count = file.values.shape
    if not columns or not all(0 <= column < count for column in columns):
        holds = f"{count} columns, 0 to {count - 1}" if count > 1 else "one column, 0"
        has = f"{file.path} has {holds} ({file.layout})"
        raise InputError(f"ground_motion: column is {list(columns)}, but {has}")
    if rows < 2:
        raise InputError(f"{file.path}: holds one sample only; a record needs two at least")
    if len(counts := {file.count(column) for column in columns}) > 1:
        raise InputError(
            f"ground_motion: column is {list(columns)}, but these columns of {file.path} differ in "
            f"length ({', '.join(map(str, sorted(counts)))}); save each as a file"
        )
    for column in columns:
        file.check_finite(column)
        if why := file.objection(column):
            other = f"that column of {file.path} {why}; choose another, 0 to {count - 1}"
            raise InputError(f"ground_motion: column is {column}, but {other}")


def given_unit(text: str) -> str:
    """Give the unit that a user names, a key of `UNITS`; empty: none.

    Raises
    ------
    InputError
        If it is not one of `GIVEN_UNITS`, in any spelling.
    """
    unit = read_unit(text)
    if text and unit not in GIVEN_UNITS:
        need = f"must be {', '.join(GIVEN_UNITS)} or gal; convert the record to g, m/s2 or cm/s2"
        raise InputError(f"ground_motion: unit is {text}, but {need}")
    return unit or ""


def _unit_of(file: Columns, column: int, given: str) -> Statement[str]:
    """Give the unit of a column; the file's and the given one must agree, and one be there."""
    stated = file.unit(column)
    if given and stated and stated.value != given:
        raise InputError(
            f"ground_motion: unit is {given}, but {file.path} says {stated.value} "
            f"({stated.place}); leave unit out to take the file's"
        )
    if stated:
        return stated
    if given:
        return Statement(given, _GIVEN)
    largest = float(np.abs(file.values[: file.count(column), column]).max())
    raise InputError(
        f"{file.path}: does not say the unit of its accelerations, of which the largest is "
        f"{largest:.4g}; set ground_motion unit (--unit) to {', '.join(GIVEN_UNITS)}"
    )


def _period_of(file: Columns, given: float) -> Statement[float]:
    """Give the sampling period; the file's and the given one must agree, and one be there."""
    own = file.dt(given)
    for each in (own, Statement(given, _GIVEN)):
        if each and each.value > _LONGEST_PERIOD:
            raise InputError(
                f"{file.path}: a sampling period of {each.value:g} s ({each.place}) is that of no "
                "ground motion; correct it"
            )
    if own is None and not given:
        raise InputError(f"{file.path}: states no sampling period; set ground_motion dt (--dt)")
    if own and given and not is_same_period(own.value, given):
        other = f"{file.path} says {own.value:g} s ({own.place}); leave dt out to take the file's"
        raise InputError(f"ground_motion: dt is {given:g} s, but {other}")
    if own and not given:
        return own
    return Statement(float(given), f"{_GIVEN}; {own.place} agrees" if own else _GIVEN)
