"""Rational transfer functions with dead time."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]


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
