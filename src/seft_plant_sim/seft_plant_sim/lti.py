"""Linear time-invariant systems: responses over frequency, holds, dead time.

In state space s' = a s + b u, y = c s + d u, or as a transfer function.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]
Polynomial = Floats | Sequence[float]


@dataclass(frozen=True)
class TransferFunction:
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
    dead_time: float = 0.0

    def response(self, frequencies_hz: Floats) -> Complexes:
        """Frequency response, same shape."""
        s = np.asarray(2j * np.pi * frequencies_hz, dtype=np.complex128)
        value = ratio(self.numerator, self.denominator, s)
        return value * np.exp(-s * self.dead_time) if self.dead_time else value


def ratio(numerator: Polynomial, denominator: Polynomial, points: Complexes) -> Complexes:
    """Quotient of two polynomials at some points of the plane; infinite at a pole."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.polyval(numerator, points) / np.polyval(denominator, points)


def state_space_response(
    a: Floats, b: Floats | Complexes, c: Floats, d: Floats | Complexes, points: Complexes
) -> Complexes:
    """Response c (p - a)^-1 b + d at N points p of the s or z plane, shape (N, outputs, inputs).

    b and d may differ from point to point.
    """
    inputs = np.broadcast_to(b, (len(points), *b.shape[-2:]))
    states = np.linalg.solve(points[:, np.newaxis, np.newaxis] * np.eye(len(a)) - a, inputs)
    return np.asarray(c @ states + d, dtype=np.complex128)


def companion_form(numerator: Floats, denominator: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Make the controllable canonical form a, b, c, d of a proper transfer function.

    Over the fastest pole: in s itself its entries spread over many decades.

    Parameters
    ----------
    numerator, denominator : ndarray
        In s, highest power first, without leading zeros.
    """
    order = denominator.size - 1
    scale = float(np.abs(np.roots(denominator)).max(initial=0.0)) or 1.0
    powers = scale ** np.arange(order, -1.0, -1.0)
    den = denominator * powers
    num = np.concatenate([np.zeros(order + 1 - numerator.size), numerator]) * powers / den[0]
    den = den / den[0]
    a = np.eye(order, k=-1)
    a[:1] = -den[1:]
    c = num[1:] - num[0] * den[1:]
    return scale * a, scale * np.eye(order, 1), c[np.newaxis], num[:1, np.newaxis]


def first_order_hold(a: Floats, b: Floats, dt: float) -> tuple[Floats, Floats, Floats]:
    """Sample s' = a s + b u with u linear in between (Van Loan 1978).

    Parameters
    ----------
    a, b : ndarray
        Shapes (s, s) and (s, p).
    dt : float
        Sampling period, s.

    Returns
    -------
    free, start, change : ndarray
        Shapes (s, s), (s, p), (s, p): the next s is free s + start u + change (next u - u).
    """
    size, inputs = b.shape
    augmented = np.zeros((size + 2 * inputs,) * 2)
    augmented[:size, :size], augmented[:size, size : size + inputs] = a * dt, b * dt
    augmented[size : size + inputs, size + inputs :] = np.eye(inputs)
    free, start, change = np.split(expm(augmented)[:size], [size, size + inputs], axis=1)
    return np.ascontiguousarray(free), start, change


def split_dead_time(delay: float, dt: float) -> tuple[int, float]:
    """Split a dead time into whole sampling periods and the remainder in s.

    Between two samples the delayed input changes once: the remainder after the first of them, at
    the sample itself where it is 0.
    """
    whole = int(delay / dt + 1e-9)
    rest = delay - whole * dt
    return whole, rest if rest > 1e-9 * dt else 0.0
