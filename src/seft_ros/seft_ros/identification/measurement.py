"""A measured frequency response on one axis."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

_AROUND = 5  # frequencies over which the magnitude is looked at: the window's main lobe
_SMOOTHED = 9  # over which the noise is averaged


@dataclass(frozen=True)
class Measurement:
    """A measured frequency response on one axis.

    Attributes
    ----------
    frequencies_hz : ndarray
        Shape (F,), increasing.
    response : ndarray
        Shape (F,).
    deviation : ndarray
        Standard deviation of the response, shape (F,).
    coherence : ndarray
        Multiple coherence, shape (F,), 0 to 1.
    """

    frequencies_hz: Floats
    response: Complexes
    deviation: Floats
    coherence: Floats

    def thinned(self, count: int) -> "Measurement":
        """Keep about ``count`` frequencies, half of them even, half even in their logarithm."""
        size = len(self.frequencies_hz)
        even = np.linspace(0, size - 1, count // 2)
        logarithmic = np.geomspace(1, size, count // 2) - 1
        kept = np.unique(np.rint(np.concatenate([even, logarithmic])).astype(int))
        return Measurement(
            self.frequencies_hz[kept],
            self.response[kept],
            self.deviation[kept],
            self.coherence[kept],
        )

    def tolerance(self, floor: float) -> Floats:
        """Error that a model may have: the noise, and a part of the magnitude; shape (F,).

        The magnitude is the largest around, so that the bottom of an antiresonance, which the
        window smears, does not outweigh its flanks.
        """
        padded = np.pad(np.abs(self.response), _AROUND // 2, mode="edge")
        around = np.lib.stride_tricks.sliding_window_view(padded, _AROUND).max(axis=1)
        variance = np.pad(self.deviation**2, _SMOOTHED // 2, mode="edge")
        noise = np.convolve(variance, np.full(_SMOOTHED, 1 / _SMOOTHED), "valid")
        tolerance: Floats = np.sqrt(noise + (floor * around) ** 2)
        return tolerance
