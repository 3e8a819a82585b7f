"""Measures of tracking from the literature, of plain signals; docs/metrics.md compares them.

Signals are of shape (N, n) or (N,), results of shape (n,) or (). A measure that makes no sense
(of a command that is zero throughout, of too few samples, of what is not finite) is NaN. Signals
of different shapes are a ValueError.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.fft import next_fast_len, rfft

from seft_ros.analysis.metrics import best_fit_delay, nrmse, paired_columns, peak, peaks

Floats = npt.NDArray[np.float64]
Steps = npt.NDArray[np.int64]

FLOORS = 3
LONG = 100_000
"""Samples from which on a record is cut to a length whose Fourier transform is fast."""


def benchmark_criteria(
    commanded: Floats,
    measured: Floats,
    reference_displacement: Floats,
    displacement: Floats,
    dt: float,
    steps: Steps | None = None,
) -> list[dict[str, float]]:
    """Evaluate a test by the criteria of the benchmark problem for real-time hybrid simulation.

    Silva, Gomez, Maghareh, Dyke & Spencer 2020, Mechanical Systems and Signal Processing 135,
    106381. There displacement is tracked and the axes are floors; in SEFT it is force. J1 is
    found between the samples (`best_fit_delay`), where the benchmark's code has whole samples
    from 0 to 49. That code takes standard deviations for RMS, and numbers otherwise: its J5 is
    the peak error of floor 1, J6 and J7 the normalised errors of floors 2 and 3.

    Parameters
    ----------
    commanded, measured : ndarray
        What is tracked, c and m, M samples: reference force and measured force of a step, N.
    reference_displacement, displacement : ndarray
        x_ref of the reference structure and x as measured, shape (L, n) or (L,), m.
    dt : float
        Sampling period, s.
    steps : ndarray of int, optional
        Steps of ``commanded`` and ``measured``, shape (M,), strictly increasing; default all. For
        J1 what is missing is interpolated; J2 and J3 count the steps there are.

    Returns
    -------
    list of dict
        Of each axis ``J1``, the tracking delay, ms, positive where the measured signal lags;
        ``J2``, RMS(m - c) / RMS(c), and ``J3``, max|m - c| / max|c|, %. The first axis has besides
        ``J4``, RMS(x_ref - x) / RMS(x_ref), and ``J7``, max|x_ref - x| / max|x_ref|, %; the second
        these as J5 and J8, the third as J6 and J9.
    """
    c, m = paired_columns(commanded, measured)
    reference, x = paired_columns(reference_displacement, displacement)
    if steps is None:
        steps = np.arange(len(c))
    found = []
    for axis, tracked in enumerate(zip(m.T, c.T, strict=True)):
        row = {
            "J1": 1e3 * _delay(*tracked, dt, steps),
            "J2": 100 * nrmse(*tracked),
            "J3": 100 * _peak_error(*tracked),
        }
        if axis < FLOORS:
            floor = x[:, axis], reference[:, axis]
            row |= {f"J{4 + axis}": 100 * nrmse(*floor), f"J{7 + axis}": 100 * _peak_error(*floor)}
        found.append(row)
    return found


def _delay(y: Floats, command: Floats, dt: float, steps: Steps) -> float:
    if not (len(steps) and np.isfinite(y).all() and np.isfinite(command).all()):
        return np.nan
    every = np.arange(steps[0], steps[-1] + 1)
    if len(every) == len(steps):
        return best_fit_delay(y, command, dt)
    return best_fit_delay(np.interp(every, steps, y), np.interp(every, steps, command), dt)


def _peak_error(y: Floats, reference: Floats) -> float:
    with np.errstate(invalid="ignore", over="ignore"):
        error, most = peak(y - reference), peak(reference)
        ratio = error / most if most > 0 else np.nan
    return ratio if np.isfinite(ratio) else np.nan


@dataclass(frozen=True)
class FrequencyEvaluation:
    """Amplitude and delay of a measured signal, by its frequency evaluation index F.

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
    `LONG` samples the few at the end are left out that would make its transform slow. Of a
    constant command the delay is NaN.

    ``power`` is l, positive, else a ValueError; at 2 F is the complex gain that fits best by least
    squares.
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
        amplitude = np.abs(index) * most_m / most_c
        delay = np.where(frequency > 0, -phase / (2 * np.pi * frequency), np.nan)
    broken = ~np.isfinite(amplitude)
    found = (amplitude, phase, frequency, delay)
    return FrequencyEvaluation(*(np.where(broken, np.nan, y).reshape(shape) for y in found))


def tracking_indicator(commanded: Floats, measured: Floats) -> Floats:
    """Accumulate the tracking indicator TI: the area that a signal encloses over its command.

    TI = (A - TA) / 2, where from one sample to the next A grows by (c' + c) / 2 (m' - m) and TA
    by (m' + m) / 2 (c' - c) (Mercan & Ricles 2007, Earthquake Engineering & Structural Dynamics
    36, 1523-1543). It grows while the measured signal lags and falls while it leads; a wrong
    amplitude alone leaves it at zero. A sine of amplitudes C and M whose measured signal lags by
    phi adds pi C M sin(phi) in each cycle. Given is TI so far at each sample, of the signals'
    shape, in the square of their unit; 0 at the first.
    """
    c, m = paired_columns(commanded, measured)
    indicator = np.zeros_like(c)
    with np.errstate(invalid="ignore", over="ignore"):
        # A and TA have the products c' m' and c m in common, which this leaves out
        indicator[1:] = np.cumsum(0.5 * (c[:-1] * m[1:] - c[1:] * m[:-1]), axis=0)
    return indicator.reshape(np.shape(commanded))


def relative_tracking_indicator(commanded: Floats, measured: Floats) -> Floats:
    """TI at the end over the square of the command's peak."""
    c, m = paired_columns(commanded, measured)
    shape = np.shape(commanded)[1:]
    if len(c) < 2:
        return np.full(shape, np.nan)
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        most = peaks(c)
        end = tracking_indicator(c / most, m / most)[-1]
    return np.where(np.isfinite(end), end, np.nan).reshape(shape)


def energy_error(force_error: Floats, velocity: Floats, dt: float) -> Floats:
    """Accumulate the work of the force error on the specimen, by the trapezoidal rule.

    Positive where force control adds energy that the reference force would not have brought
    (as damping taken away), negative where it takes energy out (as damping added). Of whole
    cycles the rule is exact for band-limited signals. It is the loop's part of an energy balance,
    which `seft_plant_sim.specimen` draws up for the specimen; after Mosqueda,
    Stojadinovic & Mahin 2007 (Journal of Structural Engineering 133, 1100-1108), who take the work
    over the error of displacement, as there it is displacement that is tracked.

    Parameters
    ----------
    force_error : ndarray
        Measured minus reference force, N.
    velocity : ndarray
        Of the specimen, relative to the ground, m/s.

    Returns
    -------
    ndarray
        Work so far at each sample, of the signals' shape, J; 0 at the first.
    """
    error, v = paired_columns(force_error, velocity)
    work = np.zeros_like(error)
    with np.errstate(invalid="ignore", over="ignore"):
        power = error * v
        work[1:] = np.cumsum((power[1:] + power[:-1]) * (dt / 2), axis=0)
    return work.reshape(np.shape(force_error))


def relative_energy_error(
    reference_force: Floats, force: Floats, velocity: Floats, dt: float
) -> Floats:
    """Energy error at the end over the largest input energy.

    The input energy is the work of the measured force so far, of which the largest magnitude
    counts. Forces of the same step, N; else as in `energy_error`.
    """
    reference, measured = paired_columns(reference_force, force)
    _, v = paired_columns(force, velocity)
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        largest = peaks(energy_error(measured, v, dt))
        work = energy_error(measured - reference, v, dt)
        end = work[-1] / largest if len(work) > 1 else np.full(work.shape[1:], np.nan)
    return np.where(np.isfinite(end), end, np.nan).reshape(np.shape(force)[1:])
