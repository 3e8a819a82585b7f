"""How well a measured response agrees with a reference, on the samples that they share.

All axes of an array are taken together. An undefined measure (of no samples, against a reference
that is zero throughout, of values that are not finite) is NaN.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.fft import irfft, next_fast_len, rfft
from seft_msgs_py.arrays import Floats, Ints

from seft_ros.bags.recording import Series, every_step

Where = slice | npt.NDArray[np.intp]


def common_steps(one: Ints, other: Ints) -> tuple[Ints, Where, Where]:
    """Find the steps that are in both, and their indices in each; both strictly increase.

    Where both are the same, as they mostly are, indices are slices: they copy nothing.
    """
    if np.array_equal(one, other):
        return one, slice(None), slice(None)
    common, in_one, in_other = np.intersect1d(one, other, assume_unique=True, return_indices=True)
    return common, in_one, in_other


_ITERATIONS = 30
_RESOLUTION = 1e-9  # of a sample
_BLOCK = 1 << 16  # of a long recording's elements that are worked on at a time


@dataclass(frozen=True)
class Agreement:
    """A response against its reference.

    Attributes
    ----------
    nrmse : float
        RMS(y - y_ref) / RMS(y_ref) over the whole recording, no shift.
    nrmse_aligned : float
        The same after the best-fit pure delay is removed.
    peak, reference_peak : float
        Largest magnitudes, in the unit of the signal.
    delay_s : float
        Best-fit pure delay, s; positive where the response lags.
    """

    nrmse: float = math.nan
    nrmse_aligned: float = math.nan
    peak: float = math.nan
    reference_peak: float = math.nan
    delay_s: float = math.nan


def agreement(y: Floats, reference: Floats, dt: float, steps: Ints | None = None) -> Agreement:
    """Compare a response with its reference.

    Parameters
    ----------
    y : ndarray
        Response at the recorded steps, shape (M, n) or (M,).
    reference : ndarray
        At every step from 0 on, shape (N, n) or (N,).
    dt : float
        Sampling period, s.
    steps : ndarray of int, optional
        Shape (M,), strictly increasing and below N; default all N. For the delay,
        missing steps are interpolated; errors count the recorded ones.
    """
    y, reference = columns(y), columns(reference)
    if steps is None:
        steps = np.arange(len(reference))
    missing = len(steps) < len(reference)
    at_steps = reference[steps] if missing else reference
    delay = aligned = math.nan
    if len(steps) and np.isfinite(y).all() and np.isfinite(reference).all():
        filled = every_step(Series(steps, y), np.arange(len(reference))) if missing else y
        delay, aligned = _best_fit(filled, reference, dt)
        if missing:
            aligned = nrmse_aligned(y, reference, dt, delay, steps)
    return Agreement(nrmse(y, at_steps), aligned, peak(y), peak(at_steps), delay)


def nrmse(y: Floats, reference: Floats) -> float:
    """RMS(y - y_ref) / RMS(y_ref), arrays of the same shape."""
    with np.errstate(invalid="ignore", over="ignore"):
        return ratio(_rms(y - reference), _rms(reference))


def nrmse_aligned(
    y: Floats, reference: Floats, dt: float, delay: float, steps: Ints | None = None
) -> float:
    """Normalised RMS error after the reference is shifted by a delay (s).

    Samples for which the shifted reference would have to be known beyond its end (as with
    a negative delay) count as free of error. ``steps`` as in `agreement`.
    """
    y, reference = columns(y), columns(reference)
    if steps is None:
        steps = np.arange(len(reference))
    if not math.isfinite(delay):
        return math.nan
    last = len(reference) - 1 + math.floor(delay / dt + 1e-6)
    known = int(np.searchsorted(steps, last, side="right"))
    shifted = delayed(reference, delay, dt)[steps[:known]]
    error = _rms(y[:known] - shifted) * math.sqrt(known / len(steps)) if known else 0.0
    return ratio(error, _rms(reference[steps]))


def peak(y: Floats) -> float:
    """Largest magnitude; NaN if there is none or a value is NaN."""
    return float(np.max(np.abs(y))) if y.size else math.nan


def best_fit_delay(y: Floats, reference: Floats, dt: float) -> float:
    """Pure delay tau (s) for which RMS(y(t) - y_ref(t - tau)) is smallest.

    It is the largest value of the cross-correlation of both signals, each zero outside its
    recording: found on the samples, up to half a record's length, then between them by Newton's
    method on the correlation's Fourier series, which is exact for band-limited signals. One
    delay for all axes. Zero where no delay makes the error smaller. Shapes (N, n) or (N,).
    """
    return _best_fit(columns(y), columns(reference), dt)[0]


def _best_fit(y: Floats, reference: Floats, dt: float) -> tuple[float, float]:
    """Delay as `best_fit_delay` finds it, and the error that is left."""
    if not all(0 < _rms(signal) < math.inf for signal in (y, reference)):  # nor NaN
        return math.nan, math.nan
    size = next_fast_len(2 * len(y), real=True)
    cross = _cross_spectrum(y, reference, size)
    longest = len(y) // 2
    delay = _refine(cross, 2 * np.pi / size, _lag(irfft(cross, size), longest)) * dt
    del cross
    error, unshifted = (nrmse_aligned(y, reference, dt, tau) for tau in (delay, 0.0))
    return (delay, error) if error < unshifted else (0.0, unshifted)


def _cross_spectrum(y: Floats, reference: Floats, size: int) -> npt.NDArray[np.complex128]:
    """Sum over the axes of Y conj(Y_ref); a recording is long, so as much as can be is in place."""
    cross = rfft(_scaled(y), size, axis=0)
    other = rfft(_scaled(reference), size, axis=0)
    for block in _blocks(len(cross)):
        cross[block] *= other[block].conj()
    del other
    return cross[:, 0] if cross.shape[1] == 1 else cross.sum(axis=1)


def _lag(correlation: Floats, longest: int) -> float:
    """Find the lag in samples, ``longest`` at most, at which the correlation is largest."""
    later, earlier = correlation[: longest + 1], correlation[len(correlation) - longest :]
    lag = int(np.argmax(later))
    if longest and earlier.max() > later[lag]:
        lag = int(np.argmax(earlier)) - longest
    return float(lag)


def delayed(y: Floats, delay: float, dt: float) -> Floats:
    """Shift a signal of shape (N, n) or (N,) by a delay (s) as if it were band-limited.

    Before its start the signal is zero: a test begins at rest. Beyond its end it goes on
    point-symmetrically and fades out, so that a recording which ends in full swing does not ring.
    """
    count, shift = len(y), delay / dt
    if shift == int(shift) and 0 <= shift < count:  # no interpolation, and exact
        return np.concatenate([np.zeros_like(y[: int(shift)]), y[: count - int(shift)]])
    size = next_fast_len(2 * count + math.ceil(abs(shift)), real=True)
    spectrum = rfft(_faded(columns(y), size), axis=0, overwrite_x=True)
    for block in _blocks(len(spectrum)):
        turns = np.arange(block.start, block.stop)[:, np.newaxis] * (shift / size)
        spectrum[block] *= np.exp(-2j * np.pi * turns)
    return irfft(spectrum, size, axis=0, overwrite_x=True)[:count].reshape(y.shape)


def _faded(y: Floats, size: int) -> Floats:
    """Go on beyond the end of a signal, as `delayed` says, with zeros after; shape (size, n)."""
    count = len(y)
    longer = np.zeros((size, y.shape[1]))
    longer[:count] = y
    beyond = longer[count : 2 * count - 1]
    np.subtract(2 * y[-1], y[-2::-1], out=beyond)
    for block in _blocks(len(beyond)):
        angle = np.pi / count * np.arange(1 + block.start, 1 + block.stop)
        beyond[block] *= (0.5 + 0.5 * np.cos(angle))[:, np.newaxis]
    return longer


def _refine(cross: npt.NDArray[np.complex128], spacing: float, lag: float) -> float:
    """Newton's method for the nearest maximum of sum Re(cross exp(i omega lag)).

    The frequencies omega are ``spacing`` apart, rad a sample.
    """
    best = lag
    for _ in range(_ITERATIONS):
        slope = curvature = 0.0
        for block in _blocks(len(cross)):
            omega = spacing * np.arange(block.start, block.stop)
            terms = cross[block] * np.exp(1j * omega * best)
            slope -= float(np.sum(omega * terms.imag))
            curvature -= float(np.sum(omega**2 * terms.real))
        if not curvature < 0:
            return lag
        change = -slope / curvature
        best = min(max(best + change, lag - 1.0), lag + 1.0)
        if abs(change) < _RESOLUTION:
            break
    return float(best)


def _blocks(count: int) -> Iterator[slice]:
    for start in range(0, count, _BLOCK):
        yield slice(start, min(start + _BLOCK, count))


def columns(y: Floats) -> Floats:
    """Give a signal of shape (N,) the shape (N, 1)."""
    return y[:, np.newaxis] if y.ndim == 1 else y


def _scaled(y: Floats) -> Floats:
    """Divide by the peak, for squares not to overflow."""
    most = peak(y)
    return y / most if math.isfinite(most) and most > 0 else y


def _rms(y: Floats) -> float:
    most = peak(y)
    if not math.isfinite(most) or most == 0:
        return most
    scaled = y / most
    return most * float(np.sqrt(np.mean(np.square(scaled, out=scaled))))


def ratio(value: float, whole: float) -> float:
    """Give value / whole; NaN where that is not finite, or the whole is not positive."""
    found = value / whole if whole > 0 else math.nan
    return float(found) if math.isfinite(found) else math.nan
