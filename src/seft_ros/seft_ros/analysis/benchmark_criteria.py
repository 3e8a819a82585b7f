"""Evaluation criteria J1 to J9 of the benchmark problem for real-time hybrid simulation."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from seft_ros.analysis.columns import paired_columns
from seft_ros.analysis.metrics import best_fit_delay, nrmse, peak

Floats = npt.NDArray[np.float64]
Steps = npt.NDArray[np.int64]

FLOORS = 3


@dataclass(frozen=True)
class BenchmarkCriteria:
    """J1 to J9 (Silva et al. 2020), of n axes; NaN where one makes no sense.

    Attributes
    ----------
    delay_ms : ndarray
        J1 of each axis, shape (n,): tracking delay, ms; positive where the measured signal lags.
    tracking_nrmse : ndarray
        J2, shape (n,): RMS(m - c) / RMS(c), %.
    tracking_peak : ndarray
        J3, shape (n,): max|m - c| / max|c|, %.
    displacement_nrmse : ndarray
        J4, J5, J6 of the first three axes, shape (min(n, 3),): RMS(x_ref - x) / RMS(x_ref), %.
    displacement_peak : ndarray
        J7, J8, J9, shape (min(n, 3),): max|x_ref - x| / max|x_ref|, %.
    """

    delay_ms: Floats
    tracking_nrmse: Floats
    tracking_peak: Floats
    displacement_nrmse: Floats
    displacement_peak: Floats

    def of_axis(self, axis: int) -> dict[str, float]:
        """Criteria that concern an axis (from 0): J1, J2, J3, and its own of J4-J6 and J7-J9."""
        tracking = (self.delay_ms, self.tracking_nrmse, self.tracking_peak)
        found = {f"J{number}": float(row[axis]) for number, row in enumerate(tracking, 1)}
        if axis < FLOORS:
            found[f"J{4 + axis}"] = float(self.displacement_nrmse[axis])
            found[f"J{7 + axis}"] = float(self.displacement_peak[axis])
        return found


def benchmark_criteria(
    commanded: Floats,
    measured: Floats,
    reference_displacement: Floats,
    displacement: Floats,
    dt: float,
    steps: Steps | None = None,
) -> BenchmarkCriteria:
    """Evaluate a test by the criteria of the RTHS benchmark.

    Silva, Gomez, Maghareh, Dyke & Spencer 2020, Mechanical Systems and Signal Processing 135,
    106381. There displacement is tracked and the axes are floors; in SEFT it is force. J1 is
    found between the samples (`best_fit_delay`), where the benchmark's code has whole samples
    from 0 to 49. That code takes standard deviations for RMS, and numbers otherwise: its J5 is
    the peak error of floor 1, J6 and J7 the normalised errors of floors 2 and 3.

    Parameters
    ----------
    commanded, measured : ndarray
        What is tracked, shape (M, n) or (M,): reference force and measured force of a step, N.
    reference_displacement, displacement : ndarray
        Of the reference structure and as measured, shape (L, n) or (L,), m.
    dt : float
        Sampling period, s.
    steps : ndarray of int, optional
        Steps of ``commanded`` and ``measured``, shape (M,), strictly increasing; default all. For
        J1 what is missing is interpolated; J2 and J3 count the steps there are.

    Raises
    ------
    ValueError
        If shapes differ.
    """
    c, m = paired_columns(commanded, measured)
    reference, x = paired_columns(reference_displacement, displacement)
    if steps is None:
        steps = np.arange(len(c))
    tracked = list(zip(m.T, c.T, strict=True))
    floors = list(zip(x.T, reference.T, strict=True))[:FLOORS]
    return BenchmarkCriteria(
        delay_ms=np.array([1e3 * _delay(y, command, dt, steps) for y, command in tracked]),
        tracking_nrmse=np.array([100 * nrmse(*pair) for pair in tracked]),
        tracking_peak=np.array([100 * _peak_error(*pair) for pair in tracked]),
        displacement_nrmse=np.array([100 * nrmse(*pair) for pair in floors]),
        displacement_peak=np.array([100 * _peak_error(*pair) for pair in floors]),
    )


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
