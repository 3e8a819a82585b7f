"""Columns of time in a record: found by their name, or given away by their values."""

import re
from pathlib import Path

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError

from seft_ros.ground_motion.column_file import ColumnFile
from seft_ros.ground_motion.text_file import not_finite

_NAME = re.compile(r"(?:time|t)[\s_,/]*[\[(]?\s*([a-z]*)\s*[\])]?", re.IGNORECASE)
_SECONDS = {
    **dict.fromkeys(("", "s", "sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "milliseconds"), 1e-3),
}
_UNEVEN = 0.01  # of a step
_RAMP_ROWS = 10
_RAMP_STEP = 0.1  # s; records are sampled faster


def named_time_column(names: tuple[str, ...]) -> tuple[int, float] | None:
    """Index of the column whose name says time, and its unit in s; None if there is none."""
    for index, name in enumerate(names):
        found = _NAME.fullmatch(name)
        if found and found.group(1).lower() in _SECONDS:
            return index, _SECONDS[found.group(1).lower()]
    return None


def time_step(path: Path, file: ColumnFile, column: int, unit: float) -> float:
    """Read the sampling period off a time column.

    Parameters
    ----------
    path : Path
        Name for the errors.
    file : ColumnFile
        At least two rows.
    column : int
        Index of the time column.
    unit : float
        Its unit in s.

    Returns
    -------
    float
        Sampling period in s.

    Raises
    ------
    InputError
        If the times do not increase evenly, within 1 % of the usual step; names the line.
    """
    times = file.values[:, column]
    bad = np.flatnonzero(~np.isfinite(times))
    if bad.size:
        raise not_finite(times[bad[0]], path, file.line_of(int(bad[0])))
    steps = np.diff(times)
    typical = float(np.median(steps))
    uneven = np.flatnonzero(np.abs(steps - typical) > _UNEVEN * abs(typical))
    if typical <= 0 or uneven.size:
        row = int(uneven[0]) + 1 if uneven.size else 1
        raise InputError(
            f"{path}: line {file.line_of(row)}: time goes from {times[row - 1]:g} to "
            f"{times[row]:g}, but its usual step is {typical:g}; resample the record evenly"
        )
    return float(f"{unit * (times[-1] - times[0]) / len(steps):.12g}")  # 0.005, not 0.00500...1


def ramp_step(values: npt.NDArray[np.float64]) -> float | None:
    """Step of values that rise evenly from zero as time does, and no acceleration; or None."""
    if len(values) < _RAMP_ROWS or not np.isfinite(values).all():
        return None
    steps = np.diff(values)
    step = float(values[-1] - values[0]) / len(steps)
    if not 0 < step <= _RAMP_STEP or np.abs(steps - step).max() > _UNEVEN * step:
        return None
    return step if abs(values[0]) <= (1 + _UNEVEN) * step else None
