"""Amplitude and delay of tracking at each frequency."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from seft_ros.analysis.columns import paired_columns
from seft_ros.analysis.metrics import best_fit_delay, delayed

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class DelayByFrequency:
    """Tracking in each of F bands; of one signal of shape (N,), without the axes.

    Attributes
    ----------
    frequency_hz : ndarray
        Centres of the bands, shape (F,), from the first above zero to Nyquist's.
    amplitude : ndarray
        Measured over commanded, |H1|, shape (F, n).
    delay_s : ndarray
        Phase delay, shape (F, n); positive where the measured signal lags.
    coherence : ndarray
        Magnitude squared, 0 to 1, shape (F, n): how far the command explains what was measured.
        Where it is low the rest means little. With one segment it is 1 and says nothing.
    """

    frequency_hz: Floats
    amplitude: Floats
    delay_s: Floats
    coherence: Floats


def delay_by_frequency(
    commanded: Floats, measured: Floats, dt: float, segment_s: float = 4.0
) -> DelayByFrequency:
    """Estimate amplitude and delay in each band from averaged cross spectra.

    H1 = S_cm / S_cc by Welch's method (Welch 1967; Bendat & Piersol, Random Data), with Hann
    windows that overlap by half and no mean. The record's best-fit delay (`best_fit_delay`) is
    taken out first and added again, so that the phase does not wrap where a delay exceeds half a
    period, and both signals' segments hold the same. NaN where the command has nothing, or
    anything is not finite.

    Parameters
    ----------
    commanded, measured : ndarray
        Shape (N, n) or (N,).
    dt : float
        Sampling period, s.
    segment_s : float
        Length of a segment, s; its inverse is the bands' width. A record that is shorter is one
        segment.

    Raises
    ------
    ValueError
        If the shapes differ.
    """
    from scipy.signal import csd, welch  # 20 MB that no node needs

    c, m = paired_columns(commanded, measured)
    size = min(len(c), max(2, round(segment_s / dt)))
    shape = np.shape(commanded)[1:]
    if size < 2:
        return DelayByFrequency(np.empty(0), *(np.empty((0, *shape)) for _ in range(3)))
    common = np.array([_common_delay(*pair, dt) for pair in zip(m.T, c.T, strict=True)])
    aligned = np.stack(
        [delayed(y, -delay, dt) for y, delay in zip(m.T, common, strict=True)], axis=1
    )
    options = {"fs": 1 / dt, "nperseg": size, "axis": 0, "detrend": "constant"}
    with np.errstate(all="ignore"):
        frequency, power = welch(c, **options)
        _, answer = welch(aligned, **options)
        _, cross = csd(c, aligned, **options)
        response = (cross / np.where(power > 0, power, np.nan))[1:]
        coherence = np.abs(cross) ** 2 / np.where(answer > 0, power * answer, np.nan)
    frequency = frequency[1:]
    delay = common - np.angle(response) / (2 * np.pi * frequency[:, np.newaxis])
    columns = (np.abs(response), delay, coherence[1:])
    return DelayByFrequency(frequency, *(y.reshape(-1, *shape) for y in columns))


def _common_delay(y: Floats, command: Floats, dt: float) -> float:
    delay = best_fit_delay(y, command, dt)
    return delay if np.isfinite(delay) else 0.0
