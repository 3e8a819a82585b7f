"""The flow of a valve by its commands, and how far the assumed valve differs, step by step."""

import math

from seft_msgs_py.arrays import Floats
from seft_plant_sim.compiled import compiled

UNCERTAIN_GAIN, UNCERTAIN_DELAY = 0.15, 2e-3
"""Standard deviation of the assumed flow gain, relative (supply pressure, temperature), and of the
valve's delay, s (a step at 500 Hz)."""

LARGEST_GAIN_ERROR, LARGEST_DELAY_ERROR = 0.3, 5e-3
"""Bounds of the estimates."""

OIL_CORRELATION_TIME = 0.1
"""Correlation time of the effects that the balance leaves out, s: within it, samples count as
one."""

MIN_PRESSURE = 0.2
"""Part of the supply pressure that is always assumed to be left for the flow: its root must not end
at 0."""


@compiled
def under_load(direction: float, force: float, capacity: float) -> float:
    """Flow of a valve that opens in a direction, over that without load (Merritt 1967)."""
    left = 1.0 - force / capacity if direction > 0.0 else 1.0 + force / capacity
    return math.sqrt(max(left, MIN_PRESSURE))


def doubt(velocity: Floats, force: Floats, oil_stiffness: Floats, dt: float) -> Floats:
    """Variance of the measured flow, (m/s)^2, from the RMS noise of velocity and force."""
    seen = velocity**2 + 2.0 * (force / (oil_stiffness * dt)) ** 2
    return seen * max(1.0, OIL_CORRELATION_TIME / dt)


@compiled
def begin_following(errors: Floats, covariance: Floats) -> None:
    """Begin a test with the assumed valves; shapes (n, 2) and (n, 3)."""
    errors[:] = 0.0
    for i in range(len(covariance)):
        covariance[i, 0] = UNCERTAIN_GAIN**2
        covariance[i, 1] = UNCERTAIN_DELAY**2
        covariance[i, 2] = 0.0


@compiled
def follow_valve(
    errors: Floats, c: Floats, flow: float, later: float, seen: float, doubt: float
) -> None:
    """Update the estimates of one valve with a sample.

    Parameters
    ----------
    errors : ndarray
        Relative error of the flow gain and error of the delay in s, shape (2,); updated.
    c : ndarray
        Their variances, then their covariance, shape (3,); updated.
    flow, later : float
        Flow of the assumed valve, m/s, and its change per delay, m/s^2.
    seen : float
        Measured flow: v + (f' + lambda f) / k_oil, m/s.
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
