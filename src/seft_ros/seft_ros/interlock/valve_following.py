"""Gain and delay of a valve, followed by recursive least squares on the oil's balance, compiled."""

import numpy as np
import numpy.typing as npt
from seft_plant_sim.compiled import compiled

Floats = npt.NDArray[np.float64]

UNCERTAIN_GAIN, UNCERTAIN_DELAY = 0.15, 2e-3
"""Standard deviation of the assumed flow gain, relative, and of the valve's delay, s."""
LARGEST_GAIN_ERROR, LARGEST_DELAY_ERROR = 0.3, 5e-3
"""Bounds of what is followed."""
ONE_SAMPLE = 0.1
"""Time over which what the balance leaves out persists, s: so long, samples count as one."""


def doubt(velocity: Floats, force: Floats, oil_stiffness: Floats, dt: float) -> Floats:
    """Variance of the flow as measured, (m/s)^2, by the RMS noise of velocity and force."""
    seen = velocity**2 + 2.0 * (force / (oil_stiffness * dt)) ** 2
    return seen * max(1.0, ONE_SAMPLE / dt)


@compiled
def begin_following(errors: Floats, covariance: Floats) -> None:
    """Begin a test, with the valves as assumed; shapes (n, 2) and (n, 3)."""
    errors[:] = 0.0
    for i in range(len(covariance)):
        covariance[i, 0] = UNCERTAIN_GAIN**2
        covariance[i, 1] = UNCERTAIN_DELAY**2
        covariance[i, 2] = 0.0


@compiled
def follow_valve(
    errors: Floats, c: Floats, flow: float, later: float, seen: float, doubt: float
) -> None:
    """Take in a sample of one valve.

    Parameters
    ----------
    errors : ndarray
        Relative error of the flow gain and error of the delay in s, shape (2,): brought up to date.
    c : ndarray
        Their variances, then their covariance, shape (3,): brought up to date.
    flow, later : float
        Flow by the valve as assumed, m/s, and its change per delay, m/s^2.
    seen : float
        Flow as measured: v + (f' + lambda f) / k_oil, m/s.
    doubt : float
        Its variance, (m/s)^2.
    """
    by_flow, by_later = c[0] * flow + c[2] * later, c[2] * flow + c[1] * later
    variance = doubt + flow * by_flow + later * by_later
    innovation = seen - flow - errors[0] * flow - errors[1] * later
    found = errors[0] + by_flow / variance * innovation
    errors[0] = min(max(found, -LARGEST_GAIN_ERROR), LARGEST_GAIN_ERROR)
    found = errors[1] + by_later / variance * innovation
    errors[1] = min(max(found, -LARGEST_DELAY_ERROR), LARGEST_DELAY_ERROR)
    c[0] -= by_flow * by_flow / variance
    c[1] -= by_later * by_later / variance
    c[2] -= by_flow * by_later / variance
