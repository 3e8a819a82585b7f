"""Sensors of the rig: their noise, bias, range and resolution."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.facts import CHANNELS, place_of
from seft_msgs_py.config.parameter_table import as_matrix, per_axis
from seft_msgs_py.errors import InputError

from seft_plant_sim.compiled import compiled

BLOCK = 4096
"""Number of steps for which noise is drawn at once."""
DISPLACEMENT, VELOCITY, ACCELERATION, FORCE = range(len(CHANNELS))
"""Rows of `CHANNELS` in a sample."""


def per_channel(
    section: Mapping[str, Any],
    axes: Sequence[str],
    form: str,
) -> Floats:
    """Give the values of a parameter of each channel, shape (4, n).

    Parameters
    ----------
    section, axes
        The section of the rig or of a node that knows it, and the names of the n axes.
    form : str
        Of the names, ``{}`` for the channel.

    Raises
    ------
    InputError
        If sizes do not fit the axes.
    """
    names = [form.format(channel) for channel in CHANNELS]
    where = [f"{place_of(name, 'rig')}: {name}" for name in names]
    rows = zip(names, where, strict=True)
    return np.array([per_axis(section[name], axes, at) for name, at in rows])


def tilt_of(
    section: Mapping[str, Any], axes: Sequence[str], places: Sequence[int], name: str
) -> Floats:
    """Give what accelerometers show of the acceleration of each axis, shape (n, n).

    Parameters
    ----------
    section, axes
        The rig's section, and the names of all axes.
    places : sequence of int
        Of the n axes of this rig.
    name : str
        Of the parameter; if it is 0, each accelerometer shows its own axis alone.

    Raises
    ------
    InputError
        If the size does not fit the axes, or it mixes axes of different rigs.
    """
    own, where = list(places), f"{place_of(name, 'rig')}: {name}"
    if not np.any(section[name]):
        return np.eye(len(own))
    tilt = as_matrix(section[name], axes, where)
    if np.delete(tilt[own], own, axis=1).any():
        raise InputError(
            f"{where} {tilt.tolist()} mixes axes of different rigs, which have "
            "their own accelerometers"
        )
    return np.ascontiguousarray(tilt[np.ix_(own, own)])


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
    cutoff : float
        Cut-off w_c / (2 pi), in Hz, of the filter that derives the velocity from the displacement;
        0: the velocity is measured.
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
def measure_channels(channels: Channels, true: Floats, noise: Floats, measured: Floats) -> int:
    """Measure a state: noise, bias, range and resolution of every sensor, in this order.

    The true state has shape (4n,). The noise (RMS 1), and the sample, which is written, have shape
    (4, n). Bit i of the result is set if a sensor of channel i is at the end of its range.
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
    return at_end


@compiled
def derive_velocity(channels: Channels, step: int, last: Floats, measured: Floats) -> None:
    """Derive the velocity of a sample from the last sample, both (4, n), if it is not measured."""
    if channels.cutoff:
        # v = s / (1 + s / w_c) x by the bilinear transform, in the steady state at the beginning
        half = np.pi * channels.cutoff * channels.dt
        gain, pole = 2 * np.pi * channels.cutoff / (1 + half), (1 - half) / (1 + half)
        for i in range(measured.shape[1]):
            change = measured[0, i] - last[0, i]
            measured[1, i] = pole * last[1, i] + gain * change if step else 0.0


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
        dt: float,
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
        ranges = per_channel(section, axes, "sensors.{}_range")
        derived, bits = (
            section["sensors.velocity"] == "derived",
            section["simulated.sensors.adc_bits"],
        )
        if derived:  # there is no velocity sensor
            for rows in (noise, bias, ranges):
                rows[VELOCITY] = 0.0
        resolution = np.zeros_like(ranges)
        if bits:
            resolution = 2.0 * ranges / 2.0**bits
            for channel, row in zip(CHANNELS, ranges, strict=True):
                if not row.all() and not (derived and channel == "velocity"):
                    raise InputError(
                        f"rig: simulated.sensors.adc_bits is {bits}, but {channel}_range is 0: a "
                        f"converter needs a range; give /**: sensors.{channel}_range"
                    )
            resolution[resolution == 0] = 1.0  # of the derived velocity: not used
        ranges[ranges == 0] = np.inf
        own = np.array([noise, bias, ranges, resolution])[:, :, list(places)]
        noise, bias, ranges, resolution = np.ascontiguousarray(own)
        cutoff = float(section["sensors.velocity_cutoff"]) if derived else 0.0
        channels = Channels(noise, bias, ranges, resolution, cutoff, dt)
        return cls(channels, section["seed"], places, faulty)

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
