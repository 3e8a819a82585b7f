"""Rational transfer functions with dead time, and how the digital loop samples them."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

ALIASES = 5
"""Multiples of the sampling rate, either way, from which the hold's images are counted in."""


@dataclass(frozen=True)
class Rational:
    """N(s) / D(s) e^(-s dead_time).

    Attributes
    ----------
    numerator, denominator : tuple of float
        In s, highest power first.
    dead_time : float
        In s.
    """

    numerator: tuple[float, ...]
    denominator: tuple[float, ...]
    dead_time: float

    def __call__(self, s: Complexes) -> Complexes:
        """Evaluate at points of the Laplace plane."""
        ratio = np.polyval(self.numerator, s) / np.polyval(self.denominator, s)
        value: Complexes = ratio * np.exp(-s * self.dead_time)
        return value

    def response(self, frequencies_hz: Floats) -> Complexes:
        """Frequency response at some frequencies, same shape."""
        return self(np.multiply(2j * np.pi, frequencies_hz))


def sampled(
    plant: Callable[[Complexes], Complexes], frequencies_hz: Floats, dt: float
) -> Complexes:
    """Response from command u_k to sample f_k of a continuous plant in the loop.

    u_k is held from sample k + 1 to k + 2. The hold's output has images at every multiple of
    the sampling rate; what the plant passes of them is folded back by the sampling::

        H_d(jw) = e^(-jw dt) sum_m H(s_m) (1 - e^(-s_m dt)) / (s_m dt),  s_m = j (w + 2 pi m / dt)

    The sum is cut at `ALIASES`: for a plant that falls with 1/s^3, as a valve and the oil's
    spring do, what is left out is of the order of 1e-4.

    Parameters
    ----------
    plant : callable
        H at points of the Laplace plane, any shape.
    frequencies_hz : ndarray
        Shape (F,), not zero.
    dt : float
        Sampling period, s.
    """
    images = np.arange(-ALIASES, ALIASES + 1) / dt
    s = np.multiply(2j * np.pi, frequencies_hz + images[:, np.newaxis])
    advance = np.exp(-2j * np.pi * frequencies_hz * dt)
    # exp(-s_m dt) is the same for every image
    folded = ((1.0 - advance) * plant(s) / (s * dt)).sum(axis=0)
    result: Complexes = advance * folded
    return result
