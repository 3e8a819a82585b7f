"""Delay from the reference force to the measured force, estimated while the test runs."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from seft_ros.reference_force.compensation.delay.force_blocks import ForceBlocks
from seft_ros.reference_force.compensation.delay.signals import whole_steps

Floats = npt.NDArray[np.float64]

MEMORY = 1.0
"""Time constant with which the past is forgotten, s."""
EVERY = 10
"""Steps from one estimate to the next."""
_ALIKE = 0.7  # least correlation coefficient of two signals that are one, delayed
_TINY = 1e-300  # N^4: no division by zero


class DelayEstimator:
    """Delay at which the measured force of each of n axes is most like the reference force.

    With both forces passed through the same band-pass, p and q, it is the lag l at which a p[k-l]
    leaves least of q[k], whatever the amplitude a: where the normalised correlation ::

        sum q[k] p[k-l] / sqrt(sum q[k]^2 sum p[k-l]^2)

    is largest, the sums fading with a time constant of a second, and between the samples by the
    parabola through three of them (Knapp & Carter 1976, IEEE Trans. ASSP 24:320-327, on time
    delay by correlation). Neither an amplitude error of the actuator nor the loop around it
    biases the estimate, as the measured force follows from the reference force whatever that is
    made of. A force that is held between the samples acts half a step later than it shows.

    The estimate stays where it is while the forces are small or not alike, keeps within its
    bounds, and moves no faster than its rate.

    Parameters
    ----------
    start : float
        First estimate, s.
    bounds : tuple of float
        Shortest and longest delay, s.
    rate : float
        Largest change, s per s.
    excitation : float
        RMS of both forces, in the band and the last second or so, from which on they tell, N.
    band : sequence of float
        Edges of the band-pass, Hz.
    dt : float
        Sampling period, s.
    axes : int
        Number of axes n.

    Attributes
    ----------
    delay : ndarray
        Present estimate, shape (n,), s.

    Raises
    ------
    InputError
        If the band does not fit the sampling rate.
    """

    def __init__(
        self,
        start: float,
        bounds: tuple[float, float],
        rate: float,
        excitation: float,
        band: Sequence[float],
        dt: float,
        axes: int,
    ) -> None:
        self.delay = np.full(axes, start)
        self._start, self._bounds, self._dt = start, bounds, dt
        self._most = rate * dt * EVERY
        self._enough = excitation**2 * MEMORY / dt
        self._lags = whole_steps(bounds[1], dt) + 2
        self._forces = ForceBlocks(band, dt, axes, past=self._lags, block=EVERY)
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
        """Take in the forces of one step.

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
        told = (
            (np.minimum(self._energy[axes, peak], self._answer[:, 0]) > self._enough)
            & (at > _ALIKE)
            & (curvature > 0)
        )
        part = np.where(told, (after - before) / (2 * np.where(told, curvature, 1.0)), 0.0)
        found = np.clip((peak + part) * self._dt, *self._bounds)
        change = np.clip(found - self.delay, -self._most, self._most)
        self.delay += np.where(told, change, 0.0)
