"""Observer of displacement and velocity: the measured motion with less noise."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.linalg import solve_discrete_are
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.facts import FORCE_DRIVEN
from seft_plant_sim.channels import acceleration_is_derived, least_noise
from seft_plant_sim.compiled import compiled
from seft_plant_sim.judge.servo_model import derived_noise
from seft_plant_sim.lti import split_dead_time

BETWEEN_SAMPLES = 3.0
"""Noise of the integrated acceleration over the sensor's: the acceleration changes between samples.
"""
UNKNOWN_VELOCITY = 100.0
"""Noise of a derived velocity, m/s: so large that it is not used."""


def sensor_noise(section: Mapping[str, Any], axes: Sequence[str]) -> Floats:
    """RMS noise of each channel, at least `seft_plant_sim.channels.MIN_NOISE`.

    Parameters
    ----------
    section : mapping
        With the facts ``sensors.*``.
    axes : sequence of str
        Names of the n axes.

    Returns
    -------
    ndarray
        Shape (4, n), m, m/s, m/s^2, N.
    """
    noise = least_noise(section, axes)
    if acceleration_is_derived(section):
        noise[1:3] = derived_noise(section, axes)[1:]
    elif section["sensors.velocity"] == "derived":
        noise[1] = UNKNOWN_VELOCITY
    return noise


def observer_gains(
    noise: Floats, dt: float, between: float = BETWEEN_SAMPLES
) -> tuple[Floats, Floats]:
    """Gains of a steady Kalman filter of displacement and velocity, driven by the acceleration.

    Parameters
    ----------
    noise : ndarray
        RMS noise of displacement (m), velocity (m/s) and acceleration (m/s^2), first rows of
        shape (3 or more, n), positive.
    dt : float
        Sampling period, s.
    between : float
        See `BETWEEN_SAMPLES`; less makes slower and smoother estimates.

    Returns
    -------
    gains : ndarray
        Shape (n, 2, 2): corrections of displacement and velocity by their innovations.
    left : ndarray
        Remaining RMS noise of displacement and velocity, shape (2, n).
    """
    n = noise.shape[1]
    gains, left = np.empty((n, 2, 2)), np.empty((2, n))
    free, push = np.array([[1.0, dt], [0.0, 1.0]]), np.array([dt * dt / 2.0, dt])
    for axis in range(n):
        x, v, a = noise[:3, axis]
        scale = np.diag([x, x / dt])  # solve the equation in units of the noise
        inverse = np.linalg.inv(scale)
        driven = inverse @ np.outer(push, push) @ inverse * (between * a) ** 2
        sensors = inverse @ np.diag([x * x, v * v]) @ inverse
        moving, one = (inverse @ free @ scale).T, np.eye(2)
        predicted = solve_discrete_are(moving, one, driven + 1e-12 * one, sensors)
        gain = predicted @ np.linalg.inv(predicted + sensors)
        gains[axis] = scale @ gain @ inverse
        left[:, axis] = np.sqrt(np.diag(scale @ (predicted - gain @ predicted) @ scale))
    return gains, left


def steps_of_force(options: Mapping[str, Any], late: float, dt: float) -> Floats:
    """Motion that a step of acceleration makes beyond one that grows linearly in a period, (2,).

    Displacement (s^2) and velocity (s) per acceleration, of an actuator of kind ``ideal`` or
    ``delay`` of which no response is known: its force steps ``late`` s and its delay after a
    sample. Of others 0.
    """
    kind = options["actuator.kind"]
    if kind not in FORCE_DRIVEN or np.any(options["actuator.response.numerator"]):
        return np.zeros(2)
    part = split_dead_time(options["actuator.delay"] + late, dt)[1]
    after = dt - part if part else 0.0
    return np.array([after * after / 2.0 - dt * dt / 6.0, after - dt / 2.0])


@compiled
def observe(gains: Floats, dt: float, is_first: bool, measured: Floats, motion: Floats) -> None:
    """Update the estimates with a sample.

    Parameters
    ----------
    gains : ndarray
        See `observer_gains`, shape (n, 2, 2).
    dt : float
        Sampling period, s.
    is_first : bool
        Whether this is the first sample.
    measured : ndarray
        Displacement, velocity, acceleration and force, shape (4, n).
    motion : ndarray
        Estimates of displacement and velocity, and the last acceleration, shape (3, n); updated.
    """
    for i in range(measured.shape[1]):
        a = measured[2, i]
        if is_first:
            motion[0, i] = measured[0, i]
            motion[1, i] = measured[1, i]
        else:  # the acceleration is linear between the samples
            before = motion[2, i]
            x = motion[0, i] + dt * (motion[1, i] + dt * (before / 3.0 + a / 6.0))
            v = motion[1, i] + 0.5 * dt * (before + a)
            off, rate = measured[0, i] - x, measured[1, i] - v
            motion[0, i] = x + gains[i, 0, 0] * off + gains[i, 0, 1] * rate
            motion[1, i] = v + gains[i, 1, 0] * off + gains[i, 1, 1] * rate
        motion[2, i] = a
