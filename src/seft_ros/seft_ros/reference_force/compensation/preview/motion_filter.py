"""Displacement and velocity, freed of sensor noise by the measured acceleration."""

from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_discrete_are

Floats = npt.NDArray[np.float64]


@lru_cache(maxsize=8)
def motion_filter(dt: float, position: float, velocity: float, acceleration: float) -> Floats:
    """Stationary Kalman filter of (x, v) that integrates the measured acceleration.

    It knows nothing of the specimen: between samples the acceleration is linear, its noise is
    what drives x and v apart from the integral (Kalman 1960).

    Parameters
    ----------
    dt : float
        Sampling period, s.
    position, velocity, acceleration : float
        RMS of the sensors' noise, m, m/s, m/s^2; positive.

    Returns
    -------
    ndarray
        Shape (2, 6): from x and v of the step before, its measured acceleration, and the
        measured x, v and a of this step, to x and v of this step.
    """
    free, gain, _ = _stationary(dt, position, velocity, acceleration)
    before = np.array([[dt * dt / 3], [dt / 2]])
    now = np.array([[dt * dt / 6], [dt / 2]])
    kept = np.eye(2) - gain
    found = np.hstack([kept @ free, kept @ before, gain, kept @ now])
    found.flags.writeable = False  # it is shared
    return found


def motion_noise(
    dt: float, position: float, velocity: float, acceleration: float, lasting: bool = False
) -> Floats:
    """Covariance of the errors that the sensors' noise leaves in x and v, shape (2, 2).

    Errors of neighbouring steps are alike. ``lasting`` gives the covariance of errors that would
    be independent and leave as much in the mean of many steps.
    """
    free, gain, spread = _stationary(dt, position, velocity, acceleration)
    left: Floats = spread - gain @ spread
    if lasting:  # left goes on as kept^j from step to step
        kept = free - gain @ free
        sums = np.linalg.solve(np.eye(2) - kept, left)
        left = sums + sums.T - left
    return left


def _stationary(
    dt: float, position: float, velocity: float, acceleration: float
) -> tuple[Floats, Floats, Floats]:
    """Transition of (x, v), gain of the measured ones, covariance before they are measured."""
    free = np.array([[1.0, dt], [0.0, 1.0]])
    drive = np.array([[dt * dt / 2], [dt]])
    noise = np.diag([position**2, velocity**2])
    spread = solve_discrete_are(free.T, np.eye(2), drive @ drive.T * acceleration**2, noise)
    return free, spread @ np.linalg.inv(spread + noise), spread
