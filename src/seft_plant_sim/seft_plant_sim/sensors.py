"""Sensors of the rig, and the limits of a test that are checked on every sample."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from seft_msgs_py.config.parameter_table import Floats, Ints, per_axis
from seft_msgs_py.errors import InputError

from seft_plant_sim.compiled import compiled
from seft_plant_sim.rig_parameters import LIMIT_NAMES, LIMIT_ROWS, LIMIT_UNITS

BLOCK = 4096
"""Steps of which the noise is drawn at once."""
CHANNELS = ("position", "velocity", "acceleration", "force")


class Channels(NamedTuple):
    """Sensors of n axes: m, m/s, m/s^2 and N over the axes.

    Attributes
    ----------
    noise : ndarray
        RMS noise, shape (4, n).
    bias : ndarray
        Constant error, shape (4, n).
    range : ndarray
        Largest magnitude that is measured, shape (4, n); infinite where there is no end.
    resolution : ndarray
        Step of the analog-digital converters, shape (4, n); 0 throughout: there are none.
    cutoff : float
        Of the filter by which the velocity is derived from the displacement, w_c / (2 pi) in Hz;
        0: it is measured.
    dt : float
        Sampling period, s.
    """

    noise: Floats
    bias: Floats
    range: Floats
    resolution: Floats
    cutoff: float = 0.0
    dt: float = 1.0


@compiled
def measure(
    channels: Channels, step: int, true: Floats, noise: Floats, last: Floats, measured: Floats
) -> int:
    """Measure a state: noise, bias, range and resolution of every sensor, in this order.

    The true state has shape (4n,); noise, of an RMS of 1, the last sample and this one, which is
    the result, have shape (4, n). Bit i of what is returned is set if a sensor of channel i is at
    its range.
    """
    n = measured.shape[1]
    at_end = 0
    for row in range(4):
        for i in range(n):
            value = true[row * n + i] + channels.noise[row, i] * noise[row, i]
            value += channels.bias[row, i]
            limit, resolution = channels.range[row, i], channels.resolution[row, i]
            if abs(value) >= limit:
                at_end |= 1 << row
                value = limit if value > 0.0 else -limit
            measured[row, i] = np.rint(value / resolution) * resolution if resolution else value
    if channels.cutoff:
        # v = s / (1 + s / w_c) x by the bilinear transform, as a filter that has long been running
        half = np.pi * channels.cutoff * channels.dt
        gain, pole = 2 * np.pi * channels.cutoff / (1 + half), (1 - half) / (1 + half)
        for i in range(n):
            change = measured[0, i] - last[0, i]
            measured[1, i] = pole * last[1, i] + gain * change if step else 0.0
    return at_end


class Sensors:
    """The sensors of a rig, and their noise.

    The noise is white and a function of seed, axis and step alone: it does not depend on which
    samples were taken before, and every way of running a test sees the same. Each axis has a noise
    of its own, by its place among those of the test (default 0 to n - 1).
    """

    def __init__(self, channels: Channels, seed: int, places: Sequence[int] | None = None) -> None:
        self.channels = channels
        self._seed = seed
        self._places = range(channels.noise.shape[1]) if places is None else places
        self._block_index = -1
        self._block: Floats = np.empty((0, *channels.noise.shape))

    @classmethod
    def from_parameters(
        cls,
        group: dict[str, Any],
        seed: int,
        dt: float,
        axes: tuple[str, ...],
        where: str,
        places: Sequence[int] | None = None,
    ) -> "Sensors":
        """Make them of the parameters ``sensors.*``, for the axes at some places, or all.

        Raises
        ------
        InputError
            If sizes do not fit the axes, or a converter has bits but no range.
        """

        def values(what: str) -> Floats:
            names = [f"{channel}_{what}" for channel in CHANNELS]
            return np.array([per_axis(group[name], axes, f"{where}.{name}") for name in names])

        noise, bias, ranges = values("noise"), values("bias"), values("range")
        own = list(range(len(axes)) if places is None else places)
        derived = group["velocity"] == "derived"
        if derived:  # there is no sensor of it
            for rows in (noise, bias, ranges):
                rows[CHANNELS.index("velocity")] = 0.0
        resolution = np.zeros_like(ranges)
        if group["adc_bits"]:
            resolution = 2.0 * ranges / 2.0 ** group["adc_bits"]
            for channel, row in zip(CHANNELS, ranges, strict=True):
                if not row.all() and not (derived and channel == "velocity"):
                    raise InputError(
                        f"{where}.adc_bits is {group['adc_bits']}, but {channel}_range is 0: "
                        f"a converter needs a range; give {where}.{channel}_range"
                    )
            resolution[resolution == 0] = 1.0  # of the velocity, which is derived: any will do
        ranges[ranges == 0] = np.inf
        noise, bias, ranges, resolution = (
            np.ascontiguousarray(rows[:, own]) for rows in (noise, bias, ranges, resolution)
        )
        cutoff = float(group["velocity_cutoff"]) if derived else 0.0
        return cls(Channels(noise, bias, ranges, resolution, cutoff, dt), seed, own)

    def noise_of(self, step: int) -> Floats:
        """Noise of a step, of an RMS of 1, shape (4, n)."""
        index, row = divmod(step, BLOCK)
        if index != self._block_index:
            self._block_index = index
            self._block = self.noise_block(index)
        return self._block[row]

    def noise_block(self, index: int, steps: int = BLOCK) -> Floats:
        """Noise of the first steps of a block, of an RMS of 1, shape (steps, 4, n).

        `BLOCK` steps are all of it.
        """
        noise = np.empty((len(self._places), steps, 4))
        for axis, rows in zip(self._places, noise, strict=True):
            np.random.default_rng([self._seed, index, axis]).standard_normal(out=rows)
        return np.ascontiguousarray(noise.transpose(1, 2, 0))


@compiled
def exceeds(limits: Floats, step: int, last: Floats, measured: Floats, largest: Floats) -> bool:
    """Say whether a sample breaks a limit; NaN breaks every limit.

    Last is the sample before it, both of shape (4, n); that of step 0 has none. The largest
    magnitudes so far, shape (8,), are brought up to date; limits are `Limits.values`.
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

    Made of the parameters ``limits.*``, of which those of rates may lack, the names of the n axes,
    and the sampling period in s.

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
        """Look at the next sample, shape (4, n); one line if it breaks a limit."""
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
        name, unit = LIMIT_ROWS[row].replace("_", " "), LIMIT_UNITS[row]
        return (
            f"{name} {found[row, column] / per:.5g} {unit} on axis {self._axes[column]} "
            f"is beyond the limit of {self.values[row] / per:g} {unit}"
        )

    def margins(self) -> dict[str, float]:
        """Smallest distance to each limit since the reset, over the limit; 0 and below: broken."""
        return dict(zip(LIMIT_ROWS, (1.0 - self.largest / self.values).tolist(), strict=True))


@compiled
def is_exceeded(times: Ints, count: int, step: int, window: int) -> bool:
    """Count an event at a step; return whether a second has more of them than allowed.

    The last of such steps, shape (allowed + 1,), are kept in turn, ``count`` is how many there
    have been before, and the window is the steps of a second.
    """
    times[count % len(times)] = step
    return count + 1 >= len(times) and times[(count + 1) % len(times)] > step - window


class SaturatedTime:
    """How long, in s, sensors may be saturated within the last second, of ``window`` steps."""

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
