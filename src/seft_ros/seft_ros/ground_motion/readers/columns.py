"""Numbers of a record as columns, and what is known of each: time, quantity, unit, period."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError

from seft_ros.ground_motion.readers.record_text import decimals, read_values
from seft_ros.ground_motion.readers.statements import (
    Peak,
    Statement,
    agreed,
    is_other_unit,
    is_same_period,
    read_unit,
)

_IN_BRACKETS = re.compile(r"[\[(]([^\[\]()]*(?:\([^()]*\))?[^\[\]()]*)[\])]")
_AFTER_WORD = re.compile(r"(?:\bin\s+|_)(\S+)$", re.IGNORECASE)
_TIME = re.compile(r"(?:time|t)[\s_,/]*[\[(]?\s*([a-z]*)\s*[\])]?", re.IGNORECASE)
_SECONDS = {
    **dict.fromkeys(("", "s", "sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "milliseconds"), 1e-3),
}
_ACCELERATION = re.compile(r"(?<![a-z])(?:acc(?:el)?(?:eration)?s?|a|a_?[gxyz])(?![a-z])", re.I)
_OTHER = re.compile(
    r"(?<![a-z])(?:vel\w*|speed|displ?\w*|spectr\w*|fourier|p?s_?[avd]|arias|force)(?![a-z])", re.I
)
_UNEVEN = 0.01  # of a step
HARMLESS_OFFSET = 0.02
"""Mean over peak that any record may have: it moves no specimen by more than some 5 % of what the
peak does, unless that hardly answers to the peak."""
_FEWEST_TIMES = 10
_LONGEST_STEP = 0.1  # s; records are sampled faster


@dataclass(frozen=True)
class Columns:
    """Numbers of a record in columns; a motion in rows is one column.

    Attributes
    ----------
    path : Path
        The file.
    values : ndarray
        Shape (N, c), in the file's units; may contain NaN and infinities.
    lines : list of int
        Number of the line of each row, or of each value of a motion in rows.
    layout : str
        How the file was read, such as ``PEER AT2``.
    names : tuple of str
        Names of the columns; empty if they have none.
    header : str
        Place of the names in brackets, as errors name it.
    own_dt : Statement of float or None
        Sampling period in the header, s; None: a column of time may give it.
    own_unit : Statement of str or None
        Acceleration unit in the header; None: the name of a column may give it.
    texts : sequence of sequences of str
        The numbers as they are written, by row; empty if rounding is no matter.
    counts : tuple of int
        Number of values of each column, where they differ; below there are NaN.
    quantities : bool
        The names tell quantities; they are not those of channels.
    sure : bool
        Each column that is not the time is a motion: the first may be taken unasked.
    peaks : tuple of Peak
        That the header states, of whichever columns.
    """

    path: Path
    values: npt.NDArray[np.float64]
    lines: list[int]
    layout: str
    names: tuple[str, ...] = ()
    header: str = ""
    own_dt: Statement[float] | None = None
    own_unit: Statement[str] | None = None
    texts: Sequence[Sequence[str]] = ()
    counts: tuple[int, ...] = ()
    quantities: bool = True
    sure: bool = True
    peaks: tuple[Peak, ...] = ()

    def count(self, column: int) -> int:
        """Give the number of values of a column."""
        return self.counts[column] if self.counts else len(self.values)

    def called(self, column: int) -> str:
        """Name a column, with its number."""
        name = f' "{self.names[column]}"' if self.names else ""
        return f"column {column}{name}"

    def unit(self, column: int) -> Statement[str] | None:
        """Give the acceleration unit in a column's name, ``acc (g)``, or of the header.

        Raises
        ------
        InputError
            If the two differ, or the name says that it is no acceleration.
        """
        name = self.names[column] if self.names and self.quantities else ""
        stated = _stated_units(name)
        unit = named_unit(name)
        if _OTHER.search(name) or (unit is None and any(map(is_other_unit, stated))):
            raise InputError(
                f"{self.path}: {self.called(column)}{self.header} is no acceleration in a unit "
                "known here; choose another --column, or convert it to g, m/s2 or cm/s2"
            )
        named = Statement(unit, "the name of the column") if unit else None
        return agreed(self.path, "unit", named, self.own_unit)

    def default(self) -> int:
        """Choose the column of a motion where none is asked for.

        Raises
        ------
        InputError
            If neither names nor a column of time tell which.
        """
        free = [c for c in range(self.values.shape[1]) if not self.objection(c)]
        if len(free) > 1 and not (self.sure or self.time()):
            count = self.values.shape[1]
            names = f" ({', '.join(self.names)})" if self.names else ""
            raise InputError(
                f"{self.path}: has {count} columns{names}, and no time: {count} motions, or one "
                "motion in rows? set ground_motion column (--column, from 0), or rows (--rows)"
            )
        said = [c for c in free if self.names and says_acceleration(self.names[c])]
        others = [c for c in free if not self.names or not _OTHER.search(self.names[c])]
        return next(iter((*said, *others, *free, 0)))

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

    def dt(self, given: float = 0.0) -> Statement[float] | None:
        """Find the sampling period in the header or the column of time, s; None: in neither.

        Times that are rounded agree with many periods, see `rounded_period`; ``given`` is taken if
        it is one of them.

        Raises
        ------
        InputError
            If the times do not increase evenly, within 1 % of the median step or half of the last
            digit that is written, or if header and times differ; names the line.
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
        period = unit * (times[-1] - times[0]) / max(len(steps), 1)
        if uneven.size:
            wanted = self.own_dt.value if self.own_dt else given
            texts = [row[column] for row in self.texts]
            rounded = rounded_period(times, texts, wanted / unit) if texts else 0.0
            if not rounded:
                row = int(uneven[0]) + 1
                raise InputError(
                    f"{self.path}: line {self.lines[row]}: time goes from {times[row - 1]:g} to "
                    f"{times[row]:g}, but its usual step is {typical:g}; resample the record "
                    "evenly, or if it is even but for rounding, give dt (--dt)"
                )
            period = unit * rounded
        found = Statement(float(f"{period:.12g}"), self.called(column))  # not 0.00500...1
        return agreed(self.path, "sampling period, s,", found, self.own_dt)

    def check_offset(self, column: int, a: npt.NDArray[np.float64], *, corrected: bool) -> None:
        """Refuse an offset that would be the motion, and a peak that is not the stated one.

        Parameters
        ----------
        column : int
            Of the file.
        a : ndarray
            Its accelerations, shape (N,), m/s^2.
        corrected : bool
            Their mean is taken off later.

        Raises
        ------
        InputError
            If the mean is more than `HARMLESS_OFFSET` of the peak without it, and would move the
            ground faster than all else; if the header states peaks, and none is the column's.
        """
        mean, largest = float(a.mean()), float(np.abs(a).max())
        moving, called = float(np.abs(a - mean).max()), self.called(column)
        remedy = "take it off by ground_motion correct: offset (--correct offset)"
        centred = next((peak for peak in self.peaks if peak.is_of(moving)), None)
        agrees = not self.peaks or any(peak.is_of(largest) for peak in self.peaks)
        if not (agrees or (corrected and centred)):
            stated = centred or self.peaks[0]
            mends = "of another --column or --unit? If not, correct that line"
            mends = f"as without an offset of {mean:.4g}; {remedy}" if centred else mends
            raise InputError(
                f"{self.path}: the largest acceleration in {called} is {largest:.4g} m/s2, but "
                f"{stated.place} states a peak of {stated.size:.4g} m/s2, {mends}"
            )
        offset = abs(mean) > HARMLESS_OFFSET * moving and len(a) >= _FEWEST_TIMES
        if offset and not corrected and abs(a.sum()) > np.ptp(np.cumsum(a - mean)):
            raise InputError(
                f"{self.path}: {called} has an offset of {mean:.4g} m/s2, with which the ground "
                f"would move faster and faster; {remedy}"
            )

    def check_finite(self, column: int) -> None:
        """Refuse a column with a NaN or an infinity; names the line."""
        bad = np.flatnonzero(~np.isfinite(self.values[: self.count(column), column]))
        if bad.size:
            row = int(bad[0])
            raise InputError(
                f"{self.path}: line {self.lines[row]}: the value is {self.values[row, column]}, "
                "not a finite number; correct the record there, or cut it off before"
            )


def _stated_units(name: str) -> list[str]:
    """Give what may be units in a name: acc (g), acc_g, or the name itself, as under another."""
    own = [name] if "/" in name or name.lower() in ("g", "gal") else []
    return [text for find in (_IN_BRACKETS, _AFTER_WORD) for text in find.findall(name)] + own


def named_unit(name: str) -> str | None:
    """Give the acceleration unit that the name of a column tells, a key of `UNITS`."""
    return next(filter(None, map(read_unit, _stated_units(name))), None)


def says_acceleration(name: str) -> bool:
    """Whether the name of a column says that it is an acceleration, or in its unit."""
    stated = named_unit(name) is not None or bool(_ACCELERATION.search(name))
    return stated and not _OTHER.search(name)


def tells_quantity(name: str) -> bool:
    """Whether the name of a column says which quantity it is, or its unit."""
    stated = _stated_units(name)
    named = says_acceleration(name) or _OTHER.search(name) is not None
    return named or any(read_unit(text) or is_other_unit(text) for text in stated)


def rounded_period(times: npt.NDArray[np.float64], texts: Sequence[str], wanted: float) -> float:
    """Find the period of times that are even before they were rounded to what is written.

    Parameters
    ----------
    times : ndarray
        Shape (N,).
    texts : sequence of str
        The same times as they are written.
    wanted : float
        Taken if the times fit it; 0: none.

    Returns
    -------
    float
        ``wanted``, if it fits; otherwise the only one of a whole number of samples per second;
        otherwise, if they differ by 0.1 % at most, the one with the fewest digits. 0: none, or the
        last digit is more than half of the period.
    """
    half = 0.5 * 10.0 ** -max(map(decimals, texts)) * (1 + 1e-6)
    numbers = np.arange(len(times))

    def fits(period: float) -> bool:
        off = times - period * numbers
        return bool(4 * half <= period and off.max() - off.min() <= 2 * half)

    if wanted > 0:
        return wanted if fits(wanted) else 0.0
    low, high = ((times[-1] - times[0] + side * 2 * half) / numbers[-1] for side in (-1, 1))
    if not low > 0:
        return 0.0
    rates = np.arange(np.ceil(1 / high), np.floor(1 / low) + 1)
    if len(rates) == 1 and fits(1 / rates[0]):
        return float(1 / rates[0])
    if len(rates) or not is_same_period(low, high):
        return 0.0
    digits = (float(f"{0.5 * (low + high):.{places}g}") for places in range(1, 13))
    return next(filter(fits, digits), 0.0)


def read_channel(
    path: Path,
    lines: Sequence[str],
    start: int,
    count: int,
    layout: str,
    dt: Statement[float] | None,
    unit: Statement[str] | None,
    width: int = 0,
    said: int = 0,
    size: float = 1.0,
) -> Columns:
    """Read evenly spaced values, each times ``size``, as a column; see `read_values`."""
    values, places = read_values(path, lines, start, count, width, said)
    return Columns(path, size * np.array([values]).T, places, layout, own_dt=dt, own_unit=unit)


def as_channels(found: Sequence[Columns], names: Sequence[str] = ()) -> Columns:
    """Join channels of one column each, which may differ in length; named if there are names.

    Raises
    ------
    InputError
        If they differ in sampling period or unit.
    """
    first = found[0]

    def key(one: Columns) -> list[object]:
        return [each and each.value for each in (one.own_dt, one.own_unit)]

    if any(key(one) != key(first) for one in found):
        differ = "its channels differ in sampling period or unit; save each as a file"
        raise InputError(f"{first.path}: {differ}")
    counts = tuple(len(one.values) for one in found)
    table = np.full((max(counts), len(found)), np.nan)
    for column, one in enumerate(found):
        table[: len(one.values), column] = one.values[:, 0]
    lines = max((one.lines for one in found), key=len)
    return replace(first, values=table, names=tuple(names), counts=counts, lines=lines)
