"""Frequency evaluation index: one amplitude and one delay for a whole record."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.fft import next_fast_len, rfft

from seft_ros.analysis.columns import paired_columns, peaks

Floats = npt.NDArray[np.float64]

LONG = 100_000
"""Samples from which on a record is cut to a length whose Fourier transform is fast."""


@dataclass(frozen=True)
class FrequencyEvaluation:
    """Amplitude and delay of a measured signal; each of shape (n,), or () for one of shape (N,).

    Attributes
    ----------
    amplitude : ndarray
        |F|: 1 is right, below 1 undershoots.
    phase_rad : ndarray
        arg F, within (-pi, pi]; negative where the measured signal lags.
    frequency_hz : ndarray
        Equivalent frequency: mean frequency of the command, weighted by its spectrum.
    delay_s : ndarray
        -phase / (2 pi frequency); positive where the measured signal lags.
    """

    amplitude: Floats
    phase_rad: Floats
    frequency_hz: Floats
    delay_s: Floats


def frequency_evaluation_index(
    commanded: Floats, measured: Floats, dt: float, power: float = 2.0
) -> FrequencyEvaluation:
    """Evaluate tracking by the frequency evaluation index (FEI).

    F = sum_j (Y_j / C_j) |C_j|^l / sum_j |C_j|^l over the discrete Fourier spectra C of the
    command and Y of what was measured, at the frequencies from 0 to below Nyquist's (Guo et al.
    2014, Smart Materials and Structures 23, 045042). Amplitude and delay follow from F and from
    the equivalent frequency f = sum_j f_j |C_j|^l / sum_j |C_j|^l. The phase is that of the
    plane's four quadrants (atan2): the arctan of the quotient, as printed, is wrong from a
    quarter of the equivalent period on. Delays are told apart up to half of it.

    The record is taken to be periodic: it should begin and end at rest. Of one longer than
    `LONG` samples the few at the end are left out that would make its transform slow. NaN where
    the command is zero throughout, or anything is not finite; of a constant command the delay is
    NaN.

    Parameters
    ----------
    commanded, measured : ndarray
        Shape (N, n) or (N,), any unit.
    dt : float
        Sampling period, s.
    power : float
        l, positive; at 2 F is the complex gain that fits best by least squares.

    Raises
    ------
    ValueError
        If the shapes differ, or power is not positive.
    """
    c, m = paired_columns(commanded, measured)
    if len(c) > LONG:
        kept = next(n for n in range(len(c), 0, -1) if next_fast_len(n, real=True) == n)
        c, m = c[:kept], m[:kept]
    if not power > 0:
        raise ValueError(f"the power is {power}, not positive")
    shape = np.shape(commanded)[1:]
    bins = (len(c) + 1) // 2
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        most_c, most_m = peaks(c), peaks(m)
        if not len(c):
            return FrequencyEvaluation(*(np.full(shape, np.nan) for _ in range(4)))
        command = rfft(c / most_c, axis=0)[:bins]
        answer = rfft(m / np.where(most_m == 0, 1.0, most_m), axis=0)[:bins]
        magnitude = np.abs(command)
        weight = magnitude**power
        weight = weight / weight.sum(axis=0)
        ratio = np.divide(answer, command, out=np.zeros_like(answer), where=magnitude > 0)
        index = (weight * ratio).sum(axis=0)
        frequency = (np.arange(bins) / (len(c) * dt)) @ weight
        phase = np.arctan2(index.imag, index.real)
        found = {
            "amplitude": np.abs(index) * most_m / most_c,
            "phase_rad": phase,
            "frequency_hz": frequency,
            "delay_s": np.where(frequency > 0, -phase / (2 * np.pi * frequency), np.nan),
        }
    broken = ~np.isfinite(found["amplitude"])
    return FrequencyEvaluation(
        **{name: np.where(broken, np.nan, value).reshape(shape) for name, value in found.items()}
    )
