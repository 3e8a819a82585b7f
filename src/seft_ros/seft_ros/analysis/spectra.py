"""What signals hold at each frequency, and how one follows another there."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from seft_ros.analysis.metrics import best_fit_delay, delayed, paired_columns

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Spectrum:
    """One-sided power spectral density of a signal.

    Attributes
    ----------
    frequency_hz : ndarray
        Shape (F,), from 0 to Nyquist's.
    power : ndarray
        Shape (F,), square of the signal's unit per Hz.
    """

    frequency_hz: Floats
    power: Floats

    @property
    def amplitude(self) -> Floats:
        """Amplitude spectral density, shape (F,), the signal's unit per root Hz."""
        return np.sqrt(self.power)

    def rms(self, low: float = 0.0, high: float = np.inf) -> float:
        """RMS of what lies in a band of frequencies, Hz, in the signal's unit."""
        inside = (self.frequency_hz >= low) & (self.frequency_hz <= high)
        width = self.frequency_hz[1] if len(self.frequency_hz) > 1 else 0.0
        return float(np.sqrt(self.power[inside].sum() * width))


def spectrum_of(y: Floats, dt: float, segment_s: float = 4.0) -> Spectrum:
    """Estimate a power spectral density from averaged segments (Welch 1967).

    Hann windows that overlap by half, and no mean; a record shorter than a segment is one. What is
    not finite makes a spectrum of NaN.

    Parameters
    ----------
    y : ndarray
        Shape (N,).
    dt, segment_s : float
        Sampling period and length of a segment, s; the inverse of that is the resolution.
    """
    from scipy.signal import welch  # 20 MB that no node needs

    size = min(len(y), max(2, round(segment_s / dt)))
    if size < 2:
        return Spectrum(np.empty(0), np.empty(0))
    with np.errstate(all="ignore"):
        return Spectrum(*welch(y, fs=1 / dt, nperseg=size, detrend="constant"))


def vibration(measured: Spectrum, exact: Spectrum, band: tuple[float, float]) -> float:
    """RMS that a signal has in a band (Hz) beyond its reference, over the whole reference's RMS.

    0 where it has no more than the reference; NaN where that is zero throughout.
    """
    beyond = measured.rms(*band) ** 2 - exact.rms(*band) ** 2
    whole = exact.rms()
    if not whole > 0 or np.isnan(beyond):
        return float("nan")
    return float(np.sqrt(max(beyond, 0.0)) / whole)


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

    H1 = S_cm / S_cc by Welch's method (Welch 1967; Bendat & Piersol, Random Data), with segments
    as in `spectrum_of`. The record's best-fit delay (`best_fit_delay`) is taken out first and
    added again, so that the phase does not wrap where a delay exceeds half a period, and both
    signals' segments hold the same. NaN where the command has nothing, or anything is not finite.

    Parameters
    ----------
    commanded, measured : ndarray
        Of the same shape, (N, n) or (N,), else a ValueError.
    dt, segment_s : float
        As in `spectrum_of`.
    """
    from scipy.signal import csd, welch

    c, m = paired_columns(commanded, measured)
    size = min(len(c), max(2, round(segment_s / dt)))
    shape = np.shape(commanded)[1:]
    if size < 2:
        return DelayByFrequency(np.empty(0), *(np.empty((0, *shape)) for _ in range(3)))
    delays = [best_fit_delay(*pair, dt) for pair in zip(m.T, c.T, strict=True)]
    common = np.where(np.isfinite(delays), delays, 0.0)
    aligned = np.stack([delayed(y, -tau, dt) for y, tau in zip(m.T, common, strict=True)], axis=1)
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
