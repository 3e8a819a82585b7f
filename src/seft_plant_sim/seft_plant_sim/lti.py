"""Linear time-invariant systems: responses over frequency, holds, dead time.

In state space s' = a s + b u, y = c s + d u, or as a transfer function.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm, solve_toeplitz
from seft_msgs_py.arrays import Complexes, Floats
from seft_msgs_py.errors import InputError

Polynomial = Floats | Sequence[float]

MIN_SAMPLES = 4.0
"""Samples in a cycle of the highest frequency that is inverted."""
OUTSIDE_WEIGHT, GAIN_WEIGHT = 0.02, 1e-4
"""Weights in least squares: of errors above that frequency, and of the inverse's own size. They
make a small drive, and no bend below."""


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
        value = polynomial_ratio(self.numerator, self.denominator, s)
        return value * np.exp(-s * self.dead_time) if self.dead_time else value


def polynomial_ratio(
    numerator: Polynomial, denominator: Polynomial, points: Complexes
) -> Complexes:
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
    sampled, end = expm(augmented)[:size], size + inputs
    return np.ascontiguousarray(sampled[:, :size]), sampled[:, size:end], sampled[:, end:]


def split_dead_time(delay: float, dt: float) -> tuple[int, float]:
    """Split a dead time into whole sampling periods and the remainder in s.

    Between two samples the delayed input changes once: at the time of the remainder after the
    first sample; if it is 0, at the sample itself.
    """
    whole = int(delay / dt + 1e-9)
    remainder = delay - whole * dt
    return whole, remainder if remainder > 1e-9 * dt else 0.0


def bilinear(
    numerator: Sequence[float], denominator: Sequence[float], dt: float
) -> tuple[Floats, Floats]:
    """Discretise a transfer function with the bilinear (Tustin) transform, no prewarping.

    Substitutes s = (2/dt) (z - 1)/(z + 1). Written out because importing scipy.signal costs
    a node 50 MB; the tests compare it with scipy.

    Parameters
    ----------
    numerator, denominator : sequence of float
        In s, highest power first.
    dt : float
        Sampling period, s.

    Returns
    -------
    b, a : ndarray
        In z, highest power first, shape (order + 1,) each, a[0] = 1.

    Raises
    ------
    InputError
        If the function is improper, has no denominator, or has a pole at s = 2/dt.
    """
    num = np.trim_zeros(np.asarray(numerator, dtype=np.float64), "f")
    den = np.trim_zeros(np.asarray(denominator, dtype=np.float64), "f")
    if not den.size:
        raise InputError("force_controller: denominator is zero")
    if num.size > den.size:
        what = f"numerator of degree {num.size - 1} over denominator of degree {den.size - 1}"
        mend = "add poles to the denominator"
        raise InputError(f"force_controller: the controller is improper: {what}; {mend}")
    order = den.size - 1

    def substitute(polynomial: Floats) -> Floats:
        result = np.zeros(order + 1)
        for power, coefficient in enumerate(polynomial[::-1]):
            term = np.array([coefficient * (2.0 / dt) ** power])
            for root in (1.0,) * power + (-1.0,) * (order - power):
                term = np.convolve(term, [1.0, -root])
            result += term
        return result

    b, a = substitute(num), substitute(den)
    if abs(a[0]) <= 1e-12 * np.abs(a).max():
        why = "where the bilinear transform does not exist; use another rate"
        raise InputError(f"force_controller: there is a pole at {2 / dt:g} rad/s, {why}")
    return b / a[0], a / a[0]


MOST_TAPS = 4000
"""Of an inverse: each takes its time in each step."""
INVERTED_FREQUENCIES = 200
"""Frequencies that are inverted, at least."""


def noncausal_inverse(
    response: Callable[[Complexes], Complexes], highest: float, taps: int, dt: float, past: int = 0
) -> Floats:
    """Weights h of samples, so that sum_j h_j y[k + j - past], through the response, gives y[k].

    By least squares over frequency, regularised; a constant y is met exactly. A delay has no causal
    inverse, but y is known ahead.

    Parameters
    ----------
    response : callable
        Frequency response at values of s, 1/s, from samples to the output.
    highest : float
        Frequency up to which it is inverted, Hz.
    taps : int
        Number of weights.
    dt : float
        Sampling period, s.
    past : int
        Number of weights of past samples; the others are those of this and future samples.

    Raises
    ------
    InputError
        If there are more than `MOST_TAPS`.
    """
    if taps > MOST_TAPS:
        why = f"the actuator's delay takes {taps} samples to invert, and {MOST_TAPS} at most are"
        raise InputError(f"/**: rate is {1 / dt:g} Hz, at which {why}; lower the rate")
    # as many frequencies as tell the inverted ones and the weights apart, whatever the rate
    count = max(math.ceil(INVERTED_FREQUENCIES * 0.5 / (dt * highest)), 2 * taps)
    f = np.linspace(0.0, 0.5 / dt, count + 1)
    weight = np.where(f <= highest, 1.0, OUTSIDE_WEIGHT)
    through = response((2j * math.pi * f).astype(np.complex128))
    weighted = weight * through
    # the normal equations are sums over frequencies: Fourier transforms, one for all rows
    row = np.fft.irfft(np.abs(weighted) ** 2)[:taps]
    row[0] += GAIN_WEIGHT
    wanted = np.fft.irfft(weight * weighted.conj())[(past - np.arange(taps)) % (2 * count)]
    h, shift = solve_toeplitz(row, np.transpose([wanted, np.ones(taps)])).T
    return np.asarray(h + (1.0 / through[0].real - h.sum()) / shift.sum() * shift)
