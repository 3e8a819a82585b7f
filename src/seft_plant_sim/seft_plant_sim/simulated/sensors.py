"""Sensors of the rig: scale, tilt, lag and filter; then noise, bias, range and resolution.

A filter is part of the continuous model, and a lag is the time at which the model is read: the rig
is integrated exactly to that time, so that both are as exact as the motion itself. As filter and
lag are linear and do not change with time, their order does not matter.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats, Ints

from seft_plant_sim.channels import (
    ACCELERATION,
    VELOCITY,
    acceleration_is_derived,
    converters,
    per_channel,
    tilt_of,
    velocity_is_derived,
)
from seft_plant_sim.compiled import compiled
from seft_plant_sim.lti import split_dead_time
from seft_plant_sim.rig_parameters import filter_of
from seft_plant_sim.simulated.continuous_model import ContinuousModel, Motion, Sensed


class Sensing(NamedTuple):
    """What the sensors of n axes show of a rig.

    Attributes
    ----------
    output : ndarray
        Takes (z, drive, residuals) to what the sensors show, transposed, shape (s + n + r, 4n);
        (0, 0) if that is the true state.
    stretch, whole : ndarray
        The stretch of a sampling period at whose end each sensor is read, and the whole periods
        after which that is sampled; shape (4n,).
    """

    output: Floats
    stretch: Ints
    whole: Ints


@compiled
def read_sensors(sensing: Sensing, motion: Motion, stretch: int, shown: Floats) -> None:
    """Read the sensors whose time is the end of a stretch; the result has shape (4n,)."""
    for i in range(len(shown)):
        if sensing.stretch[i] == stretch:
            shown[i] = 0.0
            for j in range(len(motion.work)):
                shown[i] += sensing.output[j, i] * motion.work[j]


def sensing_of(
    model: ContinuousModel, parts: Sequence[float], dt: float
) -> tuple[list[float], Ints, Sensing]:
    """Divide a sampling period where drives change and where sensors are read.

    Parameters
    ----------
    model : ContinuousModel
        With its sensors.
    parts : sequence of float
        Time at which the drive of each axis changes, s; 0: at the sample.
    dt : float
        Sampling period, s.

    Returns
    -------
    lengths : list of float
        Of the stretches, s; without lags those between the drives' changes.
    change : ndarray
        The last stretch before the change of each drive, shape (n,); -1: it changes at the sample.
    sensing : Sensing
        When and how the sensors are read.
    """
    split = [split_dead_time(lag, dt) for lag in model.shown.late.tolist()]
    ends = [dt]
    for time in (*(part for part in parts if part), *(dt - remainder for _, remainder in split)):
        if min(abs(end - time) for end in ends) > 1e-9 * dt:
            ends.append(time)
    ends.sort()

    def stretch(time: float) -> int:
        return int(np.argmin([abs(end - time) for end in ends]))

    lengths = [end - begin for begin, end in zip([0.0, *ends[:-1]], ends, strict=True)]
    change = np.array([stretch(part) if part else -1 for part in parts])
    if model.sensed is None:
        nothing = np.zeros(0, np.int64)
        return lengths, change, Sensing(np.zeros((0, 0)), nothing, nothing)
    output = np.hstack([model.sensed.c, model.sensed.d, model.sensed.outputs]).T
    at = np.array([stretch(dt - remainder) for _, remainder in split])
    whole = np.array([number for number, _ in split])
    return lengths, change, Sensing(np.ascontiguousarray(output), at, whole)


def with_sensors(
    model: ContinuousModel, section: dict[str, Any], axes: Sequence[str], places: Sequence[int]
) -> ContinuousModel:
    """Put the sensors of a rig's section behind a model of the axes at some places.

    Raises
    ------
    InputError
        If sizes do not fit the axes, or the tilt mixes axes of different rigs.
    """
    own, names = list(places), ("scale", "lag", "filter", "filter_damping")
    scale, lag, cutoff, damping = (
        per_channel(section, axes, f"simulated.sensors.{{}}_{what}")[:, own] for what in names
    )
    if section["sensors.velocity"] == "derived":  # there is no velocity sensor
        scale[VELOCITY], lag[VELOCITY], cutoff[VELOCITY] = 1.0, 0.0, 0.0
    mix = tilt_of(section, axes, own, "simulated.sensors.tilt")
    is_true = (scale == 1.0).all() and (mix == np.eye(len(mix))).all()
    if is_true and not (lag.any() or cutoff.any()):
        return model
    filters = np.array(filter_of(cutoff.ravel(), damping.ravel()))
    return sensed(model, scale.ravel(), mix, lag.ravel(), filters)


def sensed(
    model: ContinuousModel, scale: Floats, mix: Floats, lag: Floats, filters: Floats
) -> ContinuousModel:
    """Put sensors behind the outputs of a model.

    Parameters
    ----------
    model : ContinuousModel
        Of n axes, without sensors.
    scale, lag, filters : ndarray
        Factor, shape (4n,), lag in s, (4n,), and `filter_of` each output, (2, 4n).
    mix : ndarray
        Accelerations that the accelerometers show per acceleration of each axis, shape (n, n).
    """
    n = len(mix)
    by_output = np.diag(scale)
    accelerations = slice(ACCELERATION * n, (ACCELERATION + 1) * n)
    by_output[accelerations, accelerations] = by_output[accelerations, accelerations] @ mix
    c, d, h = by_output @ model.c, by_output @ model.d, by_output @ model.outputs
    rows = np.flatnonzero(filters[1])
    none = np.zeros((2, len(rows)))
    return filtered(replace(model, sensed=Sensed(c, d, h, lag)), rows, none, filters[:, rows])


def filtered(
    model: ContinuousModel, rows: Ints, numerator: Floats, denominator: Floats
) -> ContinuousModel:
    """Pass some of what a model shows through (1 + p s + q s^2) / (1 + P s + Q s^2).

    Parameters
    ----------
    model : ContinuousModel
        Of n axes.
    rows : ndarray
        Places of the m outputs, shape (m,).
    numerator, denominator : ndarray
        p and q, P and Q of each, shape (2, m), or of all, (2, 1); s and s^2.
    """
    m, size = len(rows), len(model.a)
    if not m:
        return model
    (p, q), (of_p, of_q) = (
        np.broadcast_to(one, (2, m))[:, :, np.newaxis] for one in (numerator, denominator)
    )
    shown, one, none = model.shown, np.eye(m), np.zeros((m, m))
    c, d, h = shown.c.copy(), shown.d.copy(), shown.outputs.copy()
    a = np.block(  # of y and y' with y + P y' + Q y'' = the output
        [
            [model.a, np.zeros((size, 2 * m))],
            [np.zeros((m, size)), none, one],
            [c[rows] / of_q, -one / of_q, -one * (of_p / of_q)],
        ]
    )
    b, inputs = (
        np.vstack([own, np.zeros((m, own.shape[1])), of_input[rows] / of_q])
        for own, of_input in ((model.b, d), (model.inputs, h))
    )
    truth, c = (np.hstack([one, np.zeros((len(c), 2 * m))]) for one in (model.c, c))
    share = q / of_q  # y + p y' + q y''
    for each in (c, d, h):
        each[rows] *= share
    c[rows, size + np.arange(m)] = 1.0 - share[:, 0]
    c[rows, size + m + np.arange(m)] = (p - share * of_p)[:, 0]
    return replace(model, a=a, b=b, c=truth, inputs=inputs, sensed=Sensed(c, d, h, shown.late))


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
    place among the axes of the test. Below it are ``faulty`` rows of noise for faults.

    They are those of the axes at some places, from the rig's section of an experiment. An
    InputError says if sizes do not fit the axes, or a converter has bits but no range.
    """

    def __init__(
        self, section: dict[str, Any], axes: Sequence[str], places: Sequence[int], faulty: int = 0
    ) -> None:
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
        self.channels = Channels(noise, bias, ranges, resolution)
        self._seed, self._places, self._faulty = section["seed"], own, faulty
        self._block_index = -1
        self._block: Floats = np.empty((0, 4 + faulty, len(own)))

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
