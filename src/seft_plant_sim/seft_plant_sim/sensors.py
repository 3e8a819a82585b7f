"""Sensors of the rig: what the data acquisition sees of the true motion and force."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.arrays import per_axis
from seft_msgs_py.errors import InputError

Floats = npt.NDArray[np.float64]

BLOCK = 4096
CHANNELS = ("position", "velocity", "acceleration", "force")


@dataclass(frozen=True)
class Channels:
    """Data of the sensors, each array of shape (4, n): m, m/s, m/s^2 and N over the axes.

    Attributes
    ----------
    noise : ndarray
        RMS noise.
    bias : ndarray
        Constant error.
    range : ndarray
        Largest magnitude that is measured; infinite where there is no end.
    resolution : ndarray
        Step of the analog-digital converters; 0 throughout: there are none.
    """

    noise: Floats
    bias: Floats
    range: Floats
    resolution: Floats

    def part(self, places: Sequence[int]) -> "Channels":
        """Take the sensors of some of the axes."""
        own = list(places)
        rows = (self.noise, self.bias, self.range, self.resolution)
        return Channels(*(np.ascontiguousarray(row[:, own]) for row in rows))


class Sensors:
    """Bias, white noise, range and resolution of every sensor, in this order.

    The noise is a function of seed, axis and step alone: it does not depend on which samples
    were taken before, and every way of running a test sees the same.

    Parameters
    ----------
    channels : Channels
        Of n axes.
    seed : int
        Seed of the noise.
    differentiator : Differentiator, optional
        Derives the velocity from the measured displacement; else it is measured.
    places : sequence of int, optional
        Numbers of the axes, by which each has a noise of its own; default 0 to n - 1.

    Attributes
    ----------
    channels, differentiator
        As given.
    """

    def __init__(
        self,
        channels: Channels,
        seed: int,
        differentiator: "Differentiator | None" = None,
        places: Sequence[int] | None = None,
    ) -> None:
        self.channels = channels
        self._seed = seed
        self._places = range(channels.noise.shape[1]) if places is None else places
        self.differentiator = differentiator
        self._block_index = -1
        self._block: Floats = np.empty((0, *channels.noise.shape))
        self._has_bias = bool(channels.bias.any())
        self._has_range = bool(np.isfinite(channels.range).any())
        self._has_resolution = bool(channels.resolution.any())
        if self._has_resolution:
            self._per_resolution = 1.0 / channels.resolution
            self._safe_square = float((channels.range * self._per_resolution).min() ** 2)
        self.saturated: list[str] = []

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
        """Make them of the parameters ``sensors.*``.

        Parameters
        ----------
        group : dict
            The parameters.
        seed : int
            Seed of the noise.
        dt : float
            Sampling period, s.
        axes : tuple of str
            Names of the axes.
        where : str
            Names the parameters.
        places : sequence of int, optional
            Those of the axes that are measured; default all.

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
        differentiator = None
        if derived:
            differentiator = Differentiator(group["velocity_cutoff"], dt, len(own))
        return cls(Channels(noise, bias, ranges, resolution).part(own), seed, differentiator, own)

    def reset(self) -> None:
        """Forget the test so far."""
        if self.differentiator is not None:
            self.differentiator.reset()

    def measure(self, step: int, state: Floats) -> Floats:
        """Measure the state at a step; `saturated` then names the sensors at their range.

        Parameters
        ----------
        step : int
            Step of the sample.
        state : ndarray
            True displacement, velocity, acceleration and force, shape (4, n).

        Returns
        -------
        ndarray
            As measured, shape (4, n).
        """
        measured = state + self._noise(step)
        channels = self.channels
        if self._has_bias:
            measured += channels.bias
        self.saturated = []
        if self._has_resolution:
            measured *= self._per_resolution
            counts = measured.ravel()
            if not counts.dot(counts) < self._safe_square:  # else none can be at its range
                self._saturate(measured, channels.range * self._per_resolution)
            np.rint(measured, out=measured)
            measured *= channels.resolution
        elif self._has_range:
            self._saturate(measured, channels.range)
        if self.differentiator is not None:
            measured[1] = self.differentiator.step(measured[0])
        return measured

    def _saturate(self, measured: Floats, limit: Floats) -> None:
        beyond = np.abs(measured) >= limit
        self.saturated = [f"{CHANNELS[row]}_range" for row, _ in np.argwhere(beyond)]
        np.clip(measured, -limit, limit, out=measured)

    def noise(self, steps: int) -> Floats:
        """Noise of the first steps of a test, shape (steps, 4, n)."""
        blocks = [self._noise_block(index) for index in range(-(-steps // BLOCK))]
        return np.concatenate(blocks)[:steps]

    def _noise(self, step: int) -> Floats:
        index, row = divmod(step, BLOCK)
        if index != self._block_index:
            self._block_index = index
            self._block = self._noise_block(index)
        return self._block[row]

    def _noise_block(self, index: int) -> Floats:
        noise = self.channels.noise
        drawn = [
            np.random.default_rng([self._seed, index, axis]).standard_normal((BLOCK, 4))
            for axis in self._places
        ]
        return np.stack(drawn, axis=2) * noise


class Differentiator:
    """Velocity from displacement, as a laboratory derives it: v = s / (1 + s / w_c) x.

    Discretised with the bilinear transform; at rest at the first displacement, as a filter is
    that has been running for long.

    Parameters
    ----------
    cutoff : float
        w_c / (2 pi), Hz.
    dt : float
        Sampling period, s.
    axes : int
        Number of axes n.

    Attributes
    ----------
    pole, gain : float
        v[k] = pole v[k-1] + gain (x[k] - x[k-1]).
    """

    def __init__(self, cutoff: float, dt: float, axes: int) -> None:
        half = np.pi * cutoff * dt
        self.gain = 2 * np.pi * cutoff / (1 + half)
        self.pole = (1 - half) / (1 + half)
        self._last = np.zeros((2, axes))
        self._running = False

    def reset(self) -> None:
        """Forget the test so far."""
        self._running = False

    def step(self, displacement: Floats) -> Floats:
        """Velocity in m/s, shape (n,), of the next displacement in m."""
        x, v = self._last
        if not self._running:
            x[:], v[:] = displacement, 0.0
            self._running = True
        v[:] = self.pole * v + self.gain * (displacement - x)
        x[:] = displacement
        return v
