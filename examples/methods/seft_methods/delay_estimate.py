"""Estimates the delay from reference force to measured force, while a test runs."""

import math
from collections.abc import Sequence

import numpy as np
import scipy.signal
from numpy.lib.stride_tricks import sliding_window_view
from seft_msgs_py.arrays import Floats
from seft_msgs_py.errors import InputError
from seft_ros.reference_force.compensation_methods import whole_steps
from seft_ros.reference_force.compensator import MethodInputs

from seft_methods.settings import WHERE, Settings, delay_range

MEMORY = 1.0
"""Time constant of the memory, s."""
EVERY = 10
"""Steps from one estimate to the next."""
_ALIKE = 0.7  # least correlation coefficient of a signal and its delayed copy
_TINY = 1e-300  # N^4: no division by zero


def band_pass(band: Sequence[float], dt: float) -> Floats:
    """High-pass and low-pass of the second order (Butterworth) in series.

    As a recursion of the direct form II, transposed.

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
            f"{WHERE}: band is {edges} Hz, but must be two frequencies above zero and below half "
            f"the sampling rate, {0.5 / dt:g} Hz, the lower first"
        )
    low, high = edges
    (b, a), (d, c) = (
        scipy.signal.butter(2, hz, kind, fs=1.0 / dt) for hz, kind in ((low, "high"), (high, "low"))
    )
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
    inputs : MethodInputs
        Gives the first estimate.
    settings : mapping
        Give the bounds, the rate, the band and the excitation: the least RMS of both forces, in
        the band and about the last second, for an estimate, N.

    Attributes
    ----------
    delay : ndarray
        Present estimate, shape (n,), s.

    Raises
    ------
    InputError
        If no delay is given, or the bounds or the band are invalid.
    """

    def __init__(self, inputs: MethodInputs, settings: Settings) -> None:
        dt, axes = inputs.dt, inputs.axes
        self._start, self._bounds = inputs.delay, delay_range(inputs, settings)
        self.delay, self._dt = np.full(axes, self._start), dt
        self._most = settings["delay_rate"] * dt * EVERY
        self._enough = settings["excitation"] ** 2 * MEMORY / dt
        self._lags = whole_steps(self._bounds[1], dt) + 2
        self._forces = ForceBlocks(settings["band"], dt, axes, self._lags, EVERY)
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
