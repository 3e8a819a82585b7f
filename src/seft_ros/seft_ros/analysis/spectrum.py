"""What a signal holds at each frequency."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

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

    Hann windows that overlap by half, and no mean; a record shorter than a segment is one.

    Parameters
    ----------
    y : ndarray
        Shape (N,); what is not finite makes a spectrum of NaN.
    dt : float
        Sampling period, s.
    segment_s : float
        Length of a segment, s; its inverse is the resolution.
    """
    from scipy.signal import welch  # 20 MB that no node needs

    size = min(len(y), max(2, round(segment_s / dt)))
    if size < 2:
        return Spectrum(np.empty(0), np.empty(0))
    with np.errstate(all="ignore"):
        frequency, power = welch(y, fs=1 / dt, nperseg=size, detrend="constant")
    return Spectrum(frequency, power)


def vibration(measured: Spectrum, exact: Spectrum, band: tuple[float, float]) -> float:
    """RMS that a signal has in a band beyond its reference, over the whole RMS of the reference.

    0 where it has no more than the reference; NaN where that is zero throughout.

    Parameters
    ----------
    measured, exact : Spectrum
        Of the signal and of its reference, in the same unit.
    band : tuple of float
        Lowest and highest frequency, Hz.
    """
    beyond = measured.rms(*band) ** 2 - exact.rms(*band) ** 2
    whole = exact.rms()
    if not whole > 0 or np.isnan(beyond):
        return float("nan")
    return float(np.sqrt(max(beyond, 0.0)) / whole)
