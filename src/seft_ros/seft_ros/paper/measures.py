"""What the paper judges by eye, as numbers."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.signal

from seft_ros.loop_shaping.margins import BAND_HZ

Floats = npt.NDArray[np.float64]

VIBRATION_HZ = BAND_HZ
"""Vibration is what lies above, Hz: up to here the paper controls force (section 3.2), and the
structures of the paper, at 10 Hz and less, do not answer there."""

_SEGMENT = 2.0  # s of Welch's segments: 0.5 Hz
_AROUND = (0.7, 1.3)  # of a natural frequency
_MOVED = 0.05  # of the largest power in the band: below, a phase says nothing
_ORDER = 4


@dataclass(frozen=True)
class Vibration:
    """What of a signal lies above `VIBRATION_HZ`.

    Attributes
    ----------
    rms : float
        Its level, in the signal's unit.
    share : float
        Its share of the signal's energy, 0 to 1.
    peak_hz : float
        Frequency at which it is strongest, Hz.
    """

    rms: float
    share: float
    peak_hz: float


def vibration(y: Floats, rate: float) -> Vibration:
    """Find the high-frequency vibration of a signal, shape (N,), by Welch's method."""
    segment = min(len(y), int(_SEGMENT * rate))
    f, density = scipy.signal.welch(y, rate, nperseg=segment)
    high = f > VIBRATION_HZ
    energy, total = float(density[high].sum()), float(density.sum())
    return Vibration(
        rms=float(np.sqrt(energy * rate / segment)),
        share=energy / total if total > 0 else float("nan"),
        peak_hz=float(f[high][density[high].argmax()]) if high.any() else float("nan"),
    )


def without_vibration(y: Floats, rate: float) -> Floats:
    """Keep what lies below `VIBRATION_HZ`, without shifting it; shape (N,) as given."""
    low_pass = scipy.signal.butter(_ORDER, VIBRATION_HZ, fs=rate, output="sos")
    edge = min(6 * _ORDER, len(y) - 1)  # what a test that tripped at once has room for
    kept: Floats = scipy.signal.sosfiltfilt(low_pass, y, padlen=edge)
    return kept


def magnitude_and_phase(
    y: Floats, reference: Floats, rate: float, natural_hz: float, delay: float
) -> tuple[float, float]:
    """Compare a response with its reference about a natural frequency.

    Parameters
    ----------
    y, reference : ndarray
        Shape (N,).
    rate : float
        Sampling rate, Hz.
    natural_hz : float
        Of the whole structure; from 0.7 to 1.3 times it they are compared.
    delay : float
        Delay that is taken out of y first, s.

    Returns
    -------
    magnitude : float
        |y / reference| over the band.
    phase : float
        Largest phase between them in the band, either way, degrees. Both are NaN where the
        signals are too short to tell.
    """
    segment = min(len(y), int(_SEGMENT * rate))
    f, cross = scipy.signal.csd(reference, y, rate, nperseg=segment)
    _, power = scipy.signal.welch(reference, rate, nperseg=segment)
    band = (f > _AROUND[0] * natural_hz) & (f < _AROUND[1] * natural_hz)
    if not band.any() or not power[band].max() > 0:  # a test that tripped at once
        return float("nan"), float("nan")
    found = cross[band] * np.exp(2j * np.pi * f[band] * delay)
    magnitude = float(abs(found.sum()) / power[band].sum())
    moved = power[band] >= _MOVED * power[band].max()
    return magnitude, float(np.abs(np.angle(found[moved], deg=True)).max())
