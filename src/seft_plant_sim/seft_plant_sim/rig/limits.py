"""Limits of a test, checked on every sample, and how near it came to them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.config.parameter_table import Parameter

from seft_plant_sim.compiled import compiled

Floats = npt.NDArray[np.float64]

NAMES = ("displacement", "velocity", "acceleration", "force")
UNITS = ("m", "m/s", "m/s^2", "N")
RATE_UNITS = ("m/s", "m/s^2", "m/s^3", "N/s")
_DEFAULTS = (0.076, 0.5, 98.1, 22200.0)
_RATE_DEFAULTS = (3.0, 300.0, 3e4, 3e6)
"""Of one sample to the next. Tests of config/jhu.yaml and config/demo.yaml that go well reach
0.48, 26, 3e3 and 1.4e5; with valve and accelerometer driven into saturation 0.48, 51, 1.5e4 and
6.5e5. An accelerometer's full range of 4 g at the oil column's 90 Hz is 2.2e4."""
ROWS = (*NAMES, *(f"{name}_rate" for name in NAMES))
_ALL_UNITS = (*UNITS, *RATE_UNITS)


def limit_rows(default_from: str = "") -> list[Parameter]:
    """Rows ``limits.*`` of a parameter table; defaults suit the paper's rig.

    Parameters
    ----------
    default_from : str
        Node whose limits stand in where these are not given.
    """
    texts = [f"largest {name} on any axis; beyond it the test trips" for name in NAMES] + [
        f"largest change of the measured {name} from one sample to the next, per second; beyond "
        "it, as when a sensor or its cable breaks, the test trips"
        for name in NAMES
    ]
    rows = [
        Parameter(f"limits.{name}", "float", default, text, unit, positive=True)
        for name, unit, default, text in zip(
            ROWS, _ALL_UNITS, (*_DEFAULTS, *_RATE_DEFAULTS), texts, strict=True
        )
    ]
    rows.append(
        Parameter(
            "limits.saturated_time",
            "float",
            0.05,
            "longest time within one second that sensors may be at the end of their range; "
            "a test that is blind for longer trips",
            "s",
            minimum=0.0,
        )
    )
    if not default_from:
        return rows
    return [replace(row, default_from=f"{default_from}:{row.name}") for row in rows]


@compiled
def exceeds(limits: Floats, step: int, last: Floats, measured: Floats, largest: Floats) -> bool:
    """Say whether a sample breaks a limit; NaN breaks every limit.

    Parameters
    ----------
    limits : ndarray
        `Limits.values`, shape (8,).
    step : int
        Step of the sample; that of step 0 has none before it.
    last, measured : ndarray
        The sample before it, and the sample: displacement, velocity, acceleration and force,
        shape (4, n).
    largest : ndarray
        Largest magnitudes so far, shape (8,): brought up to date.
    """
    broken = False
    for row in range(4):
        for i in range(measured.shape[1]):
            size = abs(measured[row, i])
            change = abs(measured[row, i] - last[row, i]) if step else 0.0
            broken |= not (size <= limits[row] and change <= limits[4 + row])
            if size > largest[row]:
                largest[row] = size
            if change > largest[4 + row]:
                largest[4 + row] = change
    return broken


class Limits:
    """Largest magnitudes of a sample, and of its change since the sample before.

    Parameters
    ----------
    limits : dict
        ``displacement`` (m), ``velocity`` (m/s), ``acceleration`` (m/s^2), ``force`` (N), and
        the same names with ``_rate`` (per second), which may lack.
    axes : sequence of str
        Names of the n axes.
    dt : float
        Sampling period, s.

    Attributes
    ----------
    values : ndarray
        Shape (8,): of the state, and of its change in a step.
    largest : ndarray
        Shape (8,): the largest magnitudes since the reset, as `exceeds` keeps them.
    """

    def __init__(self, limits: Mapping[str, Any], axes: Sequence[str], dt: float) -> None:
        self._axes = tuple(axes)
        self._dt = dt
        values = [limits[name] for name in NAMES]
        values += [limits.get(f"{name}_rate", np.inf) * dt for name in NAMES]
        self.values = np.array(values, dtype=np.float64)
        self.largest = np.zeros(8)
        self._last: Floats | None = None

    def reset(self) -> None:
        """Begin a new test."""
        self.largest[:] = 0.0
        self._last = None

    def violation(self, measured: Floats) -> str | None:
        """Look at the next sample, shape (4, n); one line if it breaks a limit."""
        measured = np.array(measured, dtype=np.float64)
        last = measured if self._last is None else self._last
        self._last = measured
        if not exceeds(self.values, 1, last, measured, self.largest):
            return None
        return self.describe(measured, measured - last)

    def describe(self, measured: Floats, change: Floats) -> str:
        """Say which limit a sample breaks.

        Parameters
        ----------
        measured, change : ndarray
            Displacement, velocity, acceleration and force, and their change since the sample
            before, shape (4, n).

        Returns
        -------
        str
            One line with limit, value and axis.
        """
        found = np.vstack([measured, change])
        row, column = np.argwhere(~(np.abs(found) <= self.values[:, np.newaxis]))[0]
        per = self._dt if row >= len(NAMES) else 1.0
        name, unit = ROWS[row].replace("_", " "), _ALL_UNITS[row]
        return (
            f"{name} {found[row, column] / per:.5g} {unit} on axis {self._axes[column]} "
            f"is beyond the limit of {self.values[row] / per:g} {unit}"
        )

    def margins(self) -> dict[str, float]:
        """Smallest distance to each limit since the reset, over the limit; 0 and below: broken."""
        return dict(zip(ROWS, (1.0 - self.largest / self.values).tolist(), strict=True))


Ints = npt.NDArray[np.int64]


@compiled
def is_exceeded(times: Ints, count: int, step: int, window: int) -> bool:
    """Count a step at which something is so; tell whether more are within a second than allowed.

    Parameters
    ----------
    times : ndarray
        The last of such steps in turn, shape (allowed + 1,): brought up to date.
    count : int
        How many there have been before.
    step, window : int
        The step, and the steps of a second.
    """
    times[count % len(times)] = step
    return count + 1 >= len(times) and times[(count + 1) % len(times)] > step - window


class SaturatedTime:
    """How long sensors may be at the end of their range within the last second.

    Parameters
    ----------
    longest : float
        Time beyond which it is a violation, s.
    dt : float
        Sampling period, s.

    Attributes
    ----------
    window : int
        Steps of a second.
    """

    def __init__(self, longest: float, dt: float) -> None:
        self._longest = longest
        self._allowed = int(longest / dt * (1 + 1e-9))
        self.window = round(1.0 / dt)

    def times(self) -> Ints:
        """Room for the steps that `is_exceeded` counts."""
        return np.zeros(min(self._allowed, self.window) + 1, dtype=np.int64)

    def describe(self, sensors: Sequence[str]) -> str:
        """Say that sensors, one at least, have been blind for too long."""
        names = " and ".join(sorted(sensors))
        return (
            f"{names} at the end of the sensor's range for more than {self._longest:g} s within "
            "one second: the test is blind"
        )
