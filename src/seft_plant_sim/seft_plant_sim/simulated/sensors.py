"""Sensors of the rig: their noise, bias, range and resolution."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats

from seft_plant_sim.channels import (
    ACCELERATION,
    VELOCITY,
    acceleration_is_derived,
    converters,
    per_channel,
    velocity_is_derived,
)
from seft_plant_sim.compiled import compiled

BLOCK = 4096
"""Number of steps for which noise is drawn at once."""


class Channels(NamedTuple):
    """Sensors of n axes: m, m/s, m/s^2 and N over the axes.

    Attributes
    ----------
    noise : ndarray
        RMS noise, shape (4, n).
    bias : ndarray
        Constant error, shape (4, n).
    range : ndarray
        Largest magnitude that is measured, shape (4, n); infinite without a limit.
    resolution : ndarray
        Step of the analog-digital converters, shape (4, n); all 0: there are none.
    """

    noise: Floats
    bias: Floats
    range: Floats
    resolution: Floats


@compiled
def measure_channels(channels: Channels, true: Floats, noise: Floats, measured: Floats) -> None:
    """Measure a state: noise, bias, range and resolution of every sensor, in this order.

    The true state has shape (4n,). The noise (RMS 1), and the sample, which is written, have shape
    (4, n).
    """
    n = measured.shape[1]
    for row in range(4):
        for i in range(n):
            value = true[row * n + i] + channels.noise[row, i] * noise[row, i]
            value += channels.bias[row, i]
            limit, resolution = channels.range[row, i], channels.resolution[row, i]
            if abs(value) >= limit:
                value = limit if value > 0.0 else -limit
            measured[row, i] = np.rint(value / resolution) * resolution if resolution else value


class Sensors:
    """The sensors of a rig, and their noise.

    The noise is white and a function of seed, axis and step alone: it does not depend on earlier
    samples, and all ways of running a test have the same noise. Each axis has its own noise, by its
    place among the axes of the test (default 0 to n - 1). Below it are ``faulty`` rows of noise for
    faults.
    """

    def __init__(
        self,
        channels: Channels,
        seed: int,
        places: Sequence[int] | None = None,
        faulty: int = 0,
    ) -> None:
        self.channels, self._faulty = channels, faulty
        self._seed = seed
        self._places = range(channels.noise.shape[1]) if places is None else places
        self._block_index = -1
        self._block: Floats = np.empty((0, 4 + faulty, channels.noise.shape[1]))

    @classmethod
    def from_parameters(
        cls,
        section: dict[str, Any],
        axes: Sequence[str],
        places: Sequence[int],
        faulty: int = 0,
    ) -> "Sensors":
        """Make those of the axes at some places from the rig's section of an experiment.

        Raises
        ------
        InputError
            If sizes do not fit the axes, or a converter has bits but no range.
        """
        noise, bias = (
            per_channel(section, axes, f"simulated.sensors.{{}}_{what}")
            for what in ("noise", "bias")
        )
        if velocity_is_derived(section):  # there is no sensor
            noise[VELOCITY] = bias[VELOCITY] = 0.0
        if acceleration_is_derived(section):
            noise[ACCELERATION] = bias[ACCELERATION] = 0.0
        own = list(places)
        ranges, resolution = converters(section, axes, own, "simulated.sensors.adc_bits")
        noise, bias = (np.ascontiguousarray(one[:, own]) for one in (noise, bias))
        return cls(Channels(noise, bias, ranges, resolution), section["seed"], places, faulty)

    def noise_of(self, step: int) -> Floats:
        """Noise of a step, RMS 1, shape (4 + faulty, n)."""
        index, row = divmod(step, BLOCK)
        if index != self._block_index:
            self._block_index = index
            self._block = self.noise_block(index)
        return self._block[row]

    def at_rest(self, steps: int) -> Floats:
        """Give the samples of the first steps of a rig that stays at rest, shape (steps, 4, n)."""
        c, firsts = self.channels, range(0, steps, BLOCK)
        blocks = [self.noise_block(at // BLOCK, min(BLOCK, steps - at)) for at in firsts]
        shown = np.clip(c.noise * np.concatenate(blocks)[:, :4] + c.bias, -c.range, c.range)
        step = np.where(c.resolution == 0.0, 1.0, c.resolution)
        return np.where(c.resolution == 0.0, shown, np.rint(shown / step) * step)

    def noise_block(self, index: int, steps: int = BLOCK) -> Floats:
        """Noise of the first steps of a block, RMS 1, shape (steps, 4 + faulty, n).

        A whole block has `BLOCK` steps.
        """
        noise = np.empty((len(self._places), steps, 4 + self._faulty))
        for axis, rows in zip(self._places, noise, strict=True):
            key = [self._seed, index, axis]
            rows[:, :4] = np.random.default_rng(key).standard_normal((steps, 4))
            for j in range(self._faulty):
                rows[:, 4 + j] = np.random.default_rng([*key, j]).standard_normal(steps)
        return np.ascontiguousarray(noise.transpose(1, 2, 0))
