"""Limits of a test, checked on every sample, and the margins to them."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats, Ints
from seft_msgs_py.config.facts import CHANNELS

from seft_plant_sim.compiled import compiled
from seft_plant_sim.rig_parameters import LIMIT_ROWS, LIMIT_UNITS

RATE_SPAN = 0.002
"""Time over which a change counts, s, or a sampling period that is longer: a period of the paper's
rig, in which a broken cable shows. Over one period the noise would count as noise times rate."""


def span_steps(dt: float) -> int:
    """Count the sampling periods in `RATE_SPAN`, at least one."""
    return max(1, round(RATE_SPAN / dt))


def largest_force_rate(limits: Mapping[str, Any]) -> float:
    """``limits.force_rate`` of the parameters ``limits.*``, N/s.

    0 there stands for the whole ``limits.force`` within `RATE_SPAN`: a fault of any rig.
    """
    return float(limits["force_rate"] or limits["force"] / RATE_SPAN)


@compiled
def exceeds(
    limits: Floats, step: int, recent: Floats, measured: Floats, change: Floats, largest: Floats
) -> int:
    """Say whether a sample (1), its change (2) or both (3) break a limit; NaN breaks each.

    Parameters
    ----------
    limits : ndarray
        `Limits.values`.
    step : int
        Of the sample; there is no change at step 0.
    recent : ndarray
        Ring buffer of the samples of the last k steps, shape (k, 4, n); updated.
    measured, change : ndarray
        The sample, and its change in k steps, which is written; in the first k steps that since
        step 0. Shape (4, n).
    largest : ndarray
        The largest magnitudes so far, shape (8,); updated.
    """
    broken, place = 0, step % len(recent) if len(recent) > 1 else 0
    oldest = place if step >= len(recent) else 0
    for row in range(4):
        for i in range(measured.shape[1]):
            value = measured[row, i]
            change[row, i] = value - recent[oldest, row, i] if step else 0.0
            recent[place, row, i] = value
            size, moved = abs(value), abs(change[row, i])
            if not size <= limits[row]:
                broken |= 1
            if not moved <= limits[4 + row]:
                broken |= 2
            if size > largest[row]:
                largest[row] = size
            if moved > largest[4 + row]:
                largest[4 + row] = moved
    return broken


def beyond_limit(row: int, value: float, axis: str, limit: float) -> str:
    """Say in one line that a value is beyond the limit of a row of `LIMIT_ROWS`."""
    name, unit = LIMIT_ROWS[row].replace("_", " "), LIMIT_UNITS[row]
    return f"{name} {value:.5g} {unit} on axis {axis} is beyond the limit of {limit:g} {unit}"


class Limits:
    """Largest magnitudes of a sample, and of its change within `RATE_SPAN`.

    Made from the parameters ``limits.*`` (limits of rates are optional), the names of the n axes,
    and the sampling period in s.

    Attributes
    ----------
    values : ndarray
        Shape (8,): of the state, and of its change in k steps.
    largest : ndarray
        Shape (8,): the largest magnitudes so far, updated by `exceeds`.
    recent, change : ndarray
        Arguments of `exceeds`, shapes (k, 4, n) and (4, n).
    """

    def __init__(self, limits: Mapping[str, Any], axes: Sequence[str], dt: float) -> None:
        self._axes = tuple(axes)
        steps = span_steps(dt)
        self._span = steps * dt
        rates = {name: limits.get(f"{name}_rate", np.inf) for name in CHANNELS}
        if "force_rate" in limits:
            rates["force"] = largest_force_rate(limits)
        values = [limits[name] for name in CHANNELS]
        values += [rates[name] * self._span for name in CHANNELS]
        self.values = np.array(values, dtype=np.float64)
        self.largest = np.zeros(8)
        self.recent = np.zeros((steps, 4, len(self._axes)))
        self.change = np.zeros((4, len(self._axes)))

    def describe(self, measured: Floats) -> str:
        """Say in one line which limit a sample, shape (4, n), or its `change` breaks."""
        found = np.vstack([measured, self.change])
        row, column = np.argwhere(~(np.abs(found) <= self.values[:, np.newaxis]))[0]
        per = self._span if row >= len(CHANNELS) else 1.0
        limit = self.values[row] / per
        return beyond_limit(int(row), found[row, column] / per, self._axes[column], limit)

    def margins(self) -> dict[str, float]:
        """Smallest distance to each limit so far, over the limit; 0 and below: broken."""
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
