"""Energy that the actuators' force error feeds into the specimen."""

import numpy as np
import numpy.typing as npt

from seft_ros.analysis.columns import paired_columns, peaks

Floats = npt.NDArray[np.float64]


def energy_error(force_error: Floats, velocity: Floats, dt: float) -> Floats:
    """Accumulate the work of the force error on the specimen, by the trapezoidal rule.

    Positive where force control adds energy that the reference force would not have brought
    (as damping taken away), negative where it takes energy out (as damping added). Of whole
    cycles the rule is exact for band-limited signals. It is the loop's part of an energy balance,
    which `seft_plant_sim.specimen.energy_balance` draws up for the specimen; after Mosqueda,
    Stojadinovic & Mahin 2007 (Journal of Structural Engineering 133, 1100-1108), who take the work
    over the error of displacement, as there it is displacement that is tracked.

    Parameters
    ----------
    force_error : ndarray
        Measured minus reference force, shape (N, n) or (N,), N.
    velocity : ndarray
        Of the specimen, relative to the ground, of the same shape, m/s.
    dt : float
        Sampling period, s.

    Returns
    -------
    ndarray
        Work so far at each sample, of the same shape, J; 0 at the first.

    Raises
    ------
    ValueError
        If the shapes differ.
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
    """Energy error at the end over the largest input energy, shape (n,) or ().

    The input energy is the work of the measured force so far, of which the largest magnitude
    counts. NaN where it is zero throughout, where there are fewer than two samples, or anything
    is not finite.

    Parameters
    ----------
    reference_force, force : ndarray
        Of the same step, shape (N, n) or (N,), N.
    velocity, dt
        As in `energy_error`.
    """
    reference, measured = paired_columns(reference_force, force)
    _, v = paired_columns(force, velocity)
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        largest = peaks(energy_error(measured, v, dt))
        work = energy_error(measured - reference, v, dt)
        end = work[-1] / largest if len(work) > 1 else np.full(work.shape[1:], np.nan)
    return np.where(np.isfinite(end), end, np.nan).reshape(np.shape(force)[1:])
