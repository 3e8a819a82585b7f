"""Limits of a test, checked on every sample, and the margins to them."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats, Ints

from seft_plant_sim.compiled import compiled
from seft_plant_sim.rig_parameters import LIMIT_NAMES, LIMIT_ROWS, LIMIT_UNITS


@compiled
def exceeds(limits: Floats, step: int, last: Floats, measured: Floats, largest: Floats) -> int:
    """Say whether a sample (1), its change (2) or both (3) break a limit; NaN breaks each.

    ``last`` is the sample before ``measured``, both of shape (4, n); it is not used at step 0. The
    largest magnitudes so far, shape (8,), are updated; ``limits`` are `Limits.values`.
    """
    broken = 0
    for row in range(4):
        for i in range(measured.shape[1]):
            size = abs(measured[row, i])
            change = abs(measured[row, i] - last[row, i]) if step else 0.0
            if not size <= limits[row]:
                broken |= 1
            if not change <= limits[4 + row]:
                broken |= 2
            if size > largest[row]:
                largest[row] = size
            if change > largest[4 + row]:
                largest[4 + row] = change
    return broken


def beyond_limit(row: int, value: float, axis: str, limit: float) -> str:
    """Say in one line that a value is beyond the limit of a row of `LIMIT_ROWS`."""
    name, unit = LIMIT_ROWS[row].replace("_", " "), LIMIT_UNITS[row]
    return f"{name} {value:.5g} {unit} on axis {axis} is beyond the limit of {limit:g} {unit}"


class Limits:
    """Largest magnitudes of a sample, and of its change since the sample before.

    Made from the parameters ``limits.*`` (limits of rates are optional), the names of the n axes,
    and the sampling period in s.

    Attributes
    ----------
    values : ndarray
        Shape (8,): of the state, and of its change in a step.
    largest : ndarray
        Shape (8,): the largest magnitudes since the reset, updated by `exceeds`.
    """

    def __init__(self, limits: Mapping[str, Any], axes: Sequence[str], dt: float) -> None:
        self._axes = tuple(axes)
        self._dt = dt
        values = [limits[name] for name in LIMIT_NAMES]
        values += [limits.get(f"{name}_rate", np.inf) * dt for name in LIMIT_NAMES]
        self.values = np.array(values, dtype=np.float64)
        self.largest = np.zeros(8)
        self._last: Floats | None = None

    def reset(self) -> None:
        """Begin a new test."""
        self.largest[:] = 0.0
        self._last = None

    def violation(self, measured: Floats) -> str | None:
        """Check the next sample, shape (4, n); one line if it breaks a limit."""
        measured = np.array(measured, dtype=np.float64)
        last = measured if self._last is None else self._last
        self._last = measured
        if not exceeds(self.values, 1, last, measured, self.largest):
            return None
        return self.describe(measured, measured - last)

    def describe(self, measured: Floats, change: Floats) -> str:
        """Say in one line which limit a sample or its change breaks; both have shape (4, n)."""
        found = np.vstack([measured, change])
        row, column = np.argwhere(~(np.abs(found) <= self.values[:, np.newaxis]))[0]
        per = self._dt if row >= len(LIMIT_NAMES) else 1.0
        limit = self.values[row] / per
        return beyond_limit(int(row), found[row, column] / per, self._axes[column], limit)

    def margins(self) -> dict[str, float]:
        """Smallest distance to each limit since the reset, over the limit; 0 and below: broken."""
        return dict(zip(LIMIT_ROWS, (1.0 - self.largest / self.values).tolist(), strict=True))


@compiled
def is_exceeded(times: Ints, count: int, step: int, window: int) -> bool:
    """Count an event at a step; return whether a second has more of them than allowed.

    ``times`` is a ring buffer of the last such steps, shape (allowed + 1,); ``count`` is their
    number so far, and ``window`` the number of steps in a second.
    """
    times[count % len(times)] = step
    return count + 1 >= len(times) and times[(count + 1) % len(times)] > step - window


def event_ring(longest: float, dt: float) -> tuple[Ints, int]:
    """Array and window for `is_exceeded`: ``longest`` s of events within a second are allowed."""
    allowed, window = int(longest / dt * (1 + 1e-9)), round(1.0 / dt)
    return np.zeros(min(allowed, window) + 1, dtype=np.int64), window
