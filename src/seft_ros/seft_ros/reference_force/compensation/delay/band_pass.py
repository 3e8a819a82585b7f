"""The band of frequencies in which two forces are compared."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError

Floats = npt.NDArray[np.float64]


class BandPass:
    """High-pass and low-pass of the second order (Butterworth) in a row, for many signals.

    Each is the bilinear transform of w^2 or s^2 over s^2 + sqrt(2) w s + w^2, prewarped, as a
    recursion of the direct form II, transposed.

    Parameters
    ----------
    band : sequence of float
        Cut-off frequencies, Hz.
    dt : float
        Sampling period, s.
    signals : int
        Number of signals p.

    Raises
    ------
    InputError
        If the band is empty or does not end below the Nyquist frequency.
    """

    def __init__(self, band: Sequence[float], dt: float, signals: int) -> None:
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
        first = np.array([1.0, 0.0, 0.0, 0.0, b[0]])
        source = np.eye(5)[4]
        second = d[0] * first + np.eye(5)[2]
        self._matrix = np.array(
            [
                np.eye(5)[1] + b[1] * source - a[1] * first,
                b[2] * source - a[2] * first,
                np.eye(5)[3] + d[1] * first - c[1] * second,
                d[2] * first - c[2] * second,
                second,
            ]
        )
        self._work = np.zeros((5, signals))

    def reset(self) -> None:
        """Forget the past."""
        self._work[:] = 0.0

    def step(self, signals: Floats) -> Floats:
        """Filter one sample of each signal, shape (p,)."""
        self._work[4] = signals
        result = self._matrix.dot(self._work)
        self._work[:4] = result[:4]
        passed: Floats = result[4]
        return passed


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
