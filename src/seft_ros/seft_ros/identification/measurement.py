"""A measured frequency response on one axis."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]


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
