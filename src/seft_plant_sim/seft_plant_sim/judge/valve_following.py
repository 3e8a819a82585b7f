"""How far an assumed valve and its oil differ from those of the rig, estimated step by step.

Over a period, a piston moves by the flow of its valve less what the oil takes (Merritt 1967)::

    change of x = (1 + e_gain) flow + e_delay (change of flow per delay)
                  - (1 + e_oil) (change of f + integral of lambda f) / k_oil

Recursive least squares find the three errors e. All signals pass the same low pass before, over the
delay of the valve: oil that rings moves the piston little, and tells nothing about the valve.
"""

import math

import numpy as np
from seft_msgs_py.arrays import Floats

from seft_plant_sim.compiled import bounded, compiled

UNCERTAIN_GAIN, UNCERTAIN_DELAY, UNCERTAIN_OIL = 0.15, 2e-3, 0.2
"""Standard deviation of the assumed flow gain, relative (supply pressure, temperature), of the
valve's delay, s (a step at 500 Hz), and of the oil's compliance, relative (air in it)."""

LARGEST_GAIN_ERROR, LARGEST_DELAY_ERROR, LARGEST_OIL_ERROR = 0.3, 5e-3, 0.5
"""Bounds of the estimates."""
UNCERTAIN_VALVE = (UNCERTAIN_GAIN, UNCERTAIN_DELAY, UNCERTAIN_OIL)
VALVE_ERRORS = 3
"""Number of errors of a valve: of gain, delay and oil."""
_BOUNDS = (LARGEST_GAIN_ERROR, LARGEST_DELAY_ERROR, LARGEST_OIL_ERROR)

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


def doubt(
    velocity: Floats, force: Floats, oil_stiffness: Floats, delay: Floats, dt: float
) -> Floats:
    """Variance of the balance of each axis after its low pass, shape (n,), (m/s)^2.

    Parameters
    ----------
    velocity, force : ndarray
        RMS noise of the observed velocity (m/s) and of the measured force (N), shape (n,).
    oil_stiffness, delay : ndarray
        N/m and s, shape (n,).
    dt : float
        Sampling period, s.
    """
    seen = velocity**2 + (force / (oil_stiffness * delay)) ** 2
    return np.asarray(seen * max(1.0, OIL_CORRELATION_TIME / dt))


@compiled
def follow_valve(
    errors: Floats, covariance: Floats, signals: Floats, doubt: float, work: Floats
) -> None:
    """Update the estimates of one valve with a sample.

    Parameters
    ----------
    errors, covariance : ndarray
        Of gain (relative), delay (s) and oil (relative), shapes (3,) and (3, 3); updated.
    signals : ndarray
        After the low pass: flow of the assumed valve, its change per delay, less what the assumed
        oil takes, and what moved the piston; shape (4,), m/s and m/s^2.
    doubt : float
        Variance of their balance, (m/s)^2.
    work : ndarray
        Shape (3,).
    """
    missed = signals[VALVE_ERRORS] - signals[0] - signals[2]
    correct_errors(errors, covariance, signals, missed, doubt, work)
    for j in range(VALVE_ERRORS):
        errors[j] = bounded(errors[j], _BOUNDS[j])


@compiled
def correct_errors(
    errors: Floats,
    covariance: Floats,
    regressor: Floats,
    missed: float,
    variance: float,
    work: Floats,
) -> None:
    """Correct three estimates by what the model without errors misses, of a variance (Kalman)."""
    for j in range(VALVE_ERRORS):
        missed -= errors[j] * regressor[j]
        work[j] = 0.0
        for k in range(VALVE_ERRORS):
            work[j] += covariance[j, k] * regressor[k]
        variance += regressor[j] * work[j]
    per_variance = 1.0 / variance
    for j in range(VALVE_ERRORS):
        errors[j] += work[j] * missed * per_variance
        for k in range(VALVE_ERRORS):
            covariance[j, k] -= work[j] * work[k] * per_variance
