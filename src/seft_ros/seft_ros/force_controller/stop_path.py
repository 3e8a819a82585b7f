"""The motion that brings a rig to rest, from the motion of its target and without a sample.

The target slows down on its path. That alone would hold the specimen where it is, which takes more
force than the test: there, inertia balances a part of the specimen's force. So meanwhile the
specimen is unloaded: each of its modes moves back by its force over its stiffness.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh
from seft_msgs_py.arrays import Floats
from seft_plant_sim.compiled import compiled
from seft_plant_sim.simulated.rig_step import left_open

SLOWED, LONGEST_UNLOADING = 0.1, 0.5
"""Longest time in which a target slows down, s: ten periods of an oil column of 100 Hz; and in
which the specimen is unloaded. Slower modes are held."""
MOST_STEPS = 500
"""Of unloading: a controller finds a stop each 10 ms between two samples, 1 us a step of it."""
UNLOADED = 0.75
"""Time of a stop over the period of the specimen's slowest mode, if that is longer: moving the mass
back then takes 0.3 of the force that is taken away."""


class StopPath(NamedTuple):
    """How the n modes of a specimen are unloaded.

    Attributes
    ----------
    mass : ndarray
        Of the specimen on the rig, shape (n, n), kg.
    modes, to_modes : ndarray
        Displacements of the axes in each mode, of mass 1, and their inverse; shape (n, n).
    squares : ndarray
        Stiffness of each mode, shape (n,), 1/s^2; 0 if it is held.
    begin, steps : int
        When unloading begins, and until rest.
    slowing : int
        Until the target rests.
    dt : float
        Sampling period, s.
    """

    mass: Floats
    modes: Floats
    to_modes: Floats
    squares: Floats
    begin: int
    steps: int
    slowing: int
    dt: float


def stop_path(mass: Floats, stiffness: Floats, horizon: int, dt: float) -> StopPath:
    """Find the modes of a specimen, shapes (n, n), and the time of a stop with a plan so long."""
    squares, modes = eigh(stiffness, mass)
    radians, slowing = 2.0 * math.pi * UNLOADED, 2 * min(horizon, round(SLOWED / 2 / dt))
    longest = min(LONGEST_UNLOADING, MOST_STEPS * dt)
    squares[squares < (radians / longest) ** 2] = 0.0
    times = radians / np.sqrt(squares[squares > 0.0])
    begin = slowing // 8  # a rig that misses a few commands goes on as if it had not
    steps = max(slowing, begin + math.ceil(times.max(initial=0.0) / dt - 1e-9))
    return StopPath(mass, modes, np.linalg.inv(modes), squares, begin, steps, slowing, dt)


@compiled
def planned_acceleration(points: Floats, i: int, dt: float) -> float:
    """Acceleration of axis i at the first point: of the parabola, or line, of its velocities."""
    now, after = points[0, 1, i], points[min(1, len(points) - 1), 1, i]
    then = points[2, 1, i] if len(points) > 2 else 2.0 * after - now
    return (2.0 * after - 1.5 * now - 0.5 * then) / dt


@compiled
def path_to_rest(p: StopPath, plan: Floats, path: Floats) -> None:
    """Slow a target down on its path, and unload the specimen.

    It unloads as the assumed one; where it is stiffer, to where the test has begun.

    Parameters
    ----------
    p : StopPath
        Of the specimen.
    plan : ndarray
        Displacement, velocity and force of the target at a step and the coming ones, (p, 3, n).
    path : ndarray
        The target on its way to rest at the same step and the coming ones, shape (m, 3, n). The
        result.
    """
    slow_down(p, plan, path)
    n, steps = len(p.squares), p.steps - p.begin
    w = 2.0 * math.pi / steps
    for m in range(n):
        x = r = 0.0
        for i in range(n):
            x += p.to_modes[m, i] * path[p.slowing, 0, i]
            r += p.modes[i, m] * path[p.slowing, 2, i]
        back = r / p.squares[m] if p.squares[m] > 0.0 else 0.0
        if back * x > 0.0 and abs(back) > abs(x):
            back = x
        for j in range(len(path)):
            k = min(max(j - p.begin, 0), steps)
            q = (k - math.sin(w * k) / w) / steps  # without a corner of the acceleration
            v = (1.0 - math.cos(w * k)) / (steps * p.dt)
            for i in range(n):
                path[j, 0, i] -= p.modes[i, m] * back * q
                path[j, 1, i] -= p.modes[i, m] * back * v
                path[j, 2, i] -= p.to_modes[m, i] * back * p.squares[m] * q
    for j in range(len(path)):
        for k in range(n):
            a = planned_acceleration(path[j:], k, p.dt)
            for i in range(n):
                path[j, 2, i] += p.mass[i, k] * a


@compiled
def slow_down(p: StopPath, plan: Floats, slowed: Floats) -> None:
    """Slow a target down to rest on its path.

    The plan has the target's motion x*(t), v*(t) and force f*(t), of which r*(t) = f* - M_e a* is
    the specimen's. With the progress w(t) = (1 + cos(pi t / T)) / 2 and its integral theta, the
    slowed target is at x*(theta), with the velocity w v*(theta) and the force r*(theta) of the
    specimen. So it needs T / 2 of the plan.

    Parameters
    ----------
    p, plan
        See `path_to_rest`.
    slowed : ndarray
        The slowed target at the same step and the coming ones, shape (m, 3, n). The result; its
        forces are those of the specimen.
    """
    n, steps = slowed.shape[2], p.slowing
    for j in range(len(slowed)):
        taken = min(j, steps)
        phase = math.pi * taken / steps
        theta = 0.5 * (taken + steps / math.pi * math.sin(phase))
        before = min(int(theta), len(plan) - 2)
        part = theta - before
        now, then = plan[before], plan[before + 1]
        for i in range(n):
            rise = then[1, i] - now[1, i]  # the velocity is linear between the points
            bend = 0.5 * part * (1.0 - part) * p.dt * rise
            slowed[j, 0, i] = now[0, i] + part * (then[0, i] - now[0, i]) - bend
            slowed[j, 1, i] = left_open(taken, steps) * (now[1, i] + part * rise)
            slowed[j, 2, i] = now[2, i] + part * (then[2, i] - now[2, i])
            for k in range(n):
                slowed[j, 2, i] -= p.mass[i, k] * (then[1, k] - now[1, k]) / p.dt
