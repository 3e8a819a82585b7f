"""Observers: the motion with less noise, and the delay from reference force to measured force."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg import solve_discrete_are
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.parameter_table import per_axis
from seft_msgs_py.errors import InputError
from seft_plant_sim.compiled import compiled
from seft_plant_sim.sensors import CHANNELS

from seft_ros.reference_force.compensator import Knowledge

BETWEEN_SAMPLES = 3.0
"""Noise of the integrated acceleration over the sensor's: the acceleration changes between samples.
"""
LEAST_NOISE = np.array([1e-6, 1e-4, 5e-3, 0.3])
"""Least assumed noise of the sensors: displacement (m), velocity, acceleration, force (N). Without
noise the filters would follow everything that is not modelled."""
UNKNOWN_VELOCITY = 100.0
"""Noise of a derived velocity, m/s: so large that it is not used."""


def sensor_noise(section: Mapping[str, Any], axes: Sequence[str], group: str, where: str) -> Floats:
    """RMS noise of each sensor, at least `LEAST_NOISE`.

    Parameters
    ----------
    section : mapping
        With parameters ``{group}.position`` and so on.
    axes : sequence of str
        Names of the n axes.
    group, where : str
        Of the parameters, for errors.

    Returns
    -------
    ndarray
        Shape (4, n), m, m/s, m/s^2, N.
    """
    names = [f"{group}.{channel}" for channel in CHANNELS]
    given = np.array([per_axis(section[n], tuple(axes), f"{where}: {n}") for n in names])
    noise = np.maximum(given, LEAST_NOISE[:, np.newaxis])
    if section[f"{group}.velocity_source"] == "derived":
        noise[1] = UNKNOWN_VELOCITY
    return noise


def observer_gains(noise: Floats, dt: float) -> tuple[Floats, Floats]:
    """Gains of a steady Kalman filter of displacement and velocity, driven by the acceleration.

    Parameters
    ----------
    noise : ndarray
        RMS noise of displacement (m), velocity (m/s) and acceleration (m/s^2), first rows of
        shape (3 or more, n), positive.
    dt : float
        Sampling period, s.

    Returns
    -------
    gains : ndarray
        Shape (n, 2, 2): corrections of displacement and velocity by their innovations.
    left : ndarray
        Remaining RMS noise of displacement and velocity, shape (2, n).
    """
    n = noise.shape[1]
    gains, left = np.empty((n, 2, 2)), np.empty((2, n))
    free, push = np.array([[1.0, dt], [0.0, 1.0]]), np.array([dt * dt / 2.0, dt])
    for axis in range(n):
        x, v, a = noise[:3, axis]
        scale = np.diag([x, x / dt])  # solve the equation in units of the noise
        inverse = np.linalg.inv(scale)
        driven = inverse @ np.outer(push, push) @ inverse * (BETWEEN_SAMPLES * a) ** 2
        sensors = inverse @ np.diag([x * x, v * v]) @ inverse
        predicted = solve_discrete_are(
            (inverse @ free @ scale).T, np.eye(2), driven + 1e-12 * np.eye(2), sensors
        )
        gain = predicted @ np.linalg.inv(predicted + sensors)
        gains[axis] = scale @ gain @ inverse
        left[:, axis] = np.sqrt(np.diag(scale @ (predicted - gain @ predicted) @ scale))
    return gains, left


@compiled
def observe(gains: Floats, dt: float, is_first: bool, measured: Floats, motion: Floats) -> None:
    """Update the estimates with a sample.

    Parameters
    ----------
    gains : ndarray
        See `observer_gains`, shape (n, 2, 2).
    dt : float
        Sampling period, s.
    is_first : bool
        Whether this is the first sample.
    measured : ndarray
        Displacement, velocity, acceleration and force, shape (4, n).
    motion : ndarray
        Estimates of displacement and velocity, and the last acceleration, shape (3, n); updated.
    """
    for i in range(measured.shape[1]):
        a = measured[2, i]
        if is_first:
            motion[0, i] = measured[0, i]
            motion[1, i] = measured[1, i]
        else:  # the acceleration is linear between the samples
            before = motion[2, i]
            x = motion[0, i] + dt * (motion[1, i] + dt * (before / 3.0 + a / 6.0))
            v = motion[1, i] + 0.5 * dt * (before + a)
            off, rate = measured[0, i] - x, measured[1, i] - v
            motion[0, i] = x + gains[i, 0, 0] * off + gains[i, 0, 1] * rate
            motion[1, i] = v + gains[i, 1, 0] * off + gains[i, 1, 1] * rate
        motion[2, i] = a


MEMORY = 1.0
"""Time constant of the memory, s."""
EVERY = 10
"""Steps from one estimate to the next."""
_ALIKE = 0.7  # least correlation coefficient of a signal and its delayed copy
_TINY = 1e-300  # N^4: no division by zero
_ROUNDING = 1e-9  # of a sampling period


def whole_steps(time: float, dt: float) -> int:
    """Fewest whole steps that cover a time, at least one."""
    return max(1, math.ceil(time / dt - _ROUNDING))


def band_pass(band: Sequence[float], dt: float) -> Floats:
    """High-pass and low-pass of the second order (Butterworth) in series.

    Each is the bilinear transform of w^2 or s^2 over s^2 + sqrt(2) w s + w^2, prewarped, as a
    recursion of the direct form II, transposed.

    Parameters
    ----------
    band : sequence of float
        Cut-off frequencies, Hz.
    dt : float
        Sampling period, s.

    Returns
    -------
    ndarray
        Takes (four states, a sample) to (the next states, the filtered sample), shape (5, 5).

    Raises
    ------
    InputError
        If the band is empty or does not end below the Nyquist frequency.
    """
    edges = np.atleast_1d(band).tolist()
    if len(edges) != 2 or not 0 < edges[0] < edges[1] < 0.5 / dt:
        raise InputError(
            f"reference_force: compensation.band is {edges} Hz, but must be two "
            f"frequencies above zero and below half the sampling rate, {0.5 / dt:g} Hz, "
            "the lower first"
        )
    low, high = edges
    (b, a), (d, c) = _second_order(low, dt, high_pass=True), _second_order(high, dt)
    # states: two of the high-pass, two of the low-pass; then the input
    _, next_1, next_2, next_3, source = np.eye(5)
    first = np.array([1.0, 0.0, 0.0, 0.0, b[0]])
    second = d[0] * first + next_2
    return np.array(
        [
            next_1 + b[1] * source - a[1] * first,
            b[2] * source - a[2] * first,
            next_3 + d[1] * first - c[1] * second,
            d[2] * first - c[2] * second,
            second,
        ]
    )


def _second_order(
    frequency_hz: float, dt: float, high_pass: bool = False
) -> tuple[list[float], list[float]]:
    """Numerator and denominator in 1/z, denominator[0] = 1."""
    t = math.tan(math.pi * frequency_hz * dt)
    scale = 1 / (1 + math.sqrt(2) * t + t * t)
    a = [1.0, 2 * (t * t - 1) * scale, (1 - math.sqrt(2) * t + t * t) * scale]
    if high_pass:
        return [scale, -2 * scale, scale], a
    return [t * t * scale, 2 * t * t * scale, t * t * scale], a


class ForceBlocks:
    """Passes both forces of n axes through the same band-pass and returns them in blocks.

    Parameters
    ----------
    band : sequence of float
        Edges of the band-pass, Hz.
    dt : float
        Sampling period, s.
    axes : int
        Number of axes n.
    past, block : int
        Steps that are returned before a block, and steps of a block.

    Raises
    ------
    InputError
        If the band does not fit the sampling rate.
    """

    def __init__(self, band: Sequence[float], dt: float, axes: int, past: int, block: int) -> None:
        self._matrix = band_pass(band, dt)
        self._work = np.zeros((5, 2 * axes))
        self._forces = self._work[4].reshape(2, axes)
        self._samples = np.zeros((past + block, 2, axes))
        self._past = self._row = past

    def reset(self) -> None:
        """Forget the past."""
        self._work[:] = 0.0
        self._samples[:] = 0.0
        self._row = self._past

    def step(self, reference: Floats, measured: Floats) -> Floats | None:
        """Add the forces of one step, shape (n,) each, N.

        A step with a value that is not finite is left out.

        Returns
        -------
        ndarray or None
            At the last step of a block: the steps before it and its own, shape (past + block, 2,
            n), reference force and measured force in the band. Valid until the next step.
        """
        if self._row == len(self._samples):
            self._samples[: self._past] = self._samples[-self._past :]
            self._row = self._past
        self._forces[0], self._forces[1] = reference, measured
        if not math.isfinite(self._forces.sum()):
            return None
        result = self._matrix.dot(self._work)
        self._work[:4] = result[:4]
        self._samples[self._row] = result[4].reshape(2, -1)
        self._row += 1
        return self._samples if self._row == len(self._samples) else None


class DelayEstimator:
    """Delay at which the measured force of each of n axes best fits the reference force.

    Both forces pass through the same band-pass and become p and q. The delay is the lag l at which
    a p[k-l] fits q[k] best, for any amplitude a: there the normalised correlation ::

        sum q[k] p[k-l] / sqrt(sum q[k]^2 sum p[k-l]^2)

    is largest. The sums fade with a time constant of a second. Between the samples the maximum is
    that of the parabola through three of them (Knapp & Carter 1976, IEEE Trans. ASSP 24:320-327, on
    time delay by correlation). Neither an amplitude error of the actuator nor the loop around it
    biases the estimate, because the measured force follows from the reference force in any case. A
    force that is held between the samples acts half a step later than its samples.

    The estimate does not change while the forces are small or uncorrelated; it stays within its
    bounds, and changes no faster than its rate.

    Parameters
    ----------
    knowledge : Knowledge
        Its options give the first estimate, the bounds, the rate, the band and the excitation: the
        least RMS of both forces, in the band and about the last second, for an estimate, N.

    Attributes
    ----------
    delay : ndarray
        Present estimate, shape (n,), s.

    Raises
    ------
    InputError
        If no delay is given, or the bounds or the band are invalid.
    """

    def __init__(self, knowledge: Knowledge) -> None:
        options, dt, axes = knowledge.options, knowledge.dt, knowledge.axes
        self._start, self._bounds = knowledge.delay, knowledge.delay_range
        self.delay, self._dt = np.full(axes, self._start), dt
        self._most = options["compensation.delay_rate"] * dt * EVERY
        self._enough = options["compensation.excitation"] ** 2 * MEMORY / dt
        self._lags = whole_steps(self._bounds[1], dt) + 2
        self._forces = ForceBlocks(options["compensation.band"], dt, axes, self._lags, EVERY)
        keep = math.exp(-dt / MEMORY)
        self._keep, self._fade = keep**EVERY, keep ** np.arange(EVERY - 1, -1, -1)
        # sums of q[k] p[k-l], of p[k-l]^2, and of q[k]^2
        self._products, self._energy = np.zeros((2, axes, self._lags))
        self._answer = np.zeros((axes, 1))
        self._axes = np.arange(axes)

    def reset(self) -> None:
        """Back to the first estimate."""
        self.delay[:] = self._start
        self._forces.reset()
        for sums in (self._products, self._energy, self._answer):
            sums[:] = 0.0

    def step(self, reference: Floats, measured: Floats) -> None:
        """Add the forces of one step.

        Parameters
        ----------
        reference, measured : ndarray
            Shape (n,), N. A step with a value that is not finite is left out.
        """
        block = self._forces.step(reference, measured)
        if block is not None:
            self._add(block[:, 0], block[:, 1])
            self._follow()

    def _add(self, p: Floats, q: Floats) -> None:
        """Add a block to the sums, and let the past fade."""
        newest = q[self._lags :] * self._fade[:, np.newaxis]
        delayed = sliding_window_view(p[1:], self._lags, axis=0)[..., ::-1]
        self._products *= self._keep
        self._products += np.einsum("sn,snl->nl", newest, delayed)
        self._energy *= self._keep
        self._energy += np.einsum("s,snl->nl", self._fade, delayed**2)
        self._answer *= self._keep
        self._answer[:, 0] += np.einsum("sn,sn->n", newest, q[self._lags :])

    def _follow(self) -> None:
        """Move the estimates towards the peaks of the correlation."""
        axes = self._axes
        correlation = self._products / np.sqrt(self._energy * self._answer + _TINY)
        peak = np.clip(correlation.argmax(axis=1), 1, self._lags - 2)
        before, at, after = (correlation[axes, peak + i] for i in (-1, 0, 1))
        curvature = 2 * at - before - after
        valid = (
            (np.minimum(self._energy[axes, peak], self._answer[:, 0]) > self._enough)
            & (at > _ALIKE)
            & (curvature > 0)
        )
        part = np.where(valid, (after - before) / (2 * np.where(valid, curvature, 1.0)), 0.0)
        found = np.clip((peak + part) * self._dt, *self._bounds)
        change = np.clip(found - self.delay, -self._most, self._most)
        self.delay += np.where(valid, change, 0.0)
