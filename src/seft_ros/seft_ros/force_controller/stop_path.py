"""The motion that brings a rig to rest, from the motion of its target and without a sample.

In each mode of the specimen on the rig, of mass 1 and stiffness w^2, the force a + w^2 q goes to 0
with the least integral of its squared change. With the Euler-Lagrange equation

    (d^2/dt^2 + w^2)^2 d^2 q / dt^2 = 0

q is a sum of 1, t, cos wt, sin wt, t cos wt and t sin wt, which begins with the target's motion and
ends at rest. Within a period of the mode this takes no more force than the target's: the force
need not hold the specimen where it is, and a mass that is not there does not help to.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh
from seft_msgs_py.arrays import Floats
from seft_plant_sim.compiled import compiled
from seft_plant_sim.simulated.rig_step import left_open

from seft_ros.force_controller.force_control import planned_acceleration

SHORTEST, LONGEST = 0.1, 0.5
"""Of a stop, s: ten periods of an oil column of 100 Hz; a fault should end sooner than that."""


class StopPath(NamedTuple):
    """Motions to rest of the n modes of a specimen.

    Attributes
    ----------
    modes, to_modes : ndarray
        Displacements of the axes of each mode, and their inverse; shape (n, n).
    squares : ndarray
        Squares of their frequencies, shape (n,), 1/s^2.
    motions : ndarray
        Displacement, velocity and acceleration at each step, per those at the beginning; shape (n,
        N + 1, 3, 3).
    begin : ndarray
        Room for the latter, shape (n, 3).
    beside : ndarray
        Room for the displacement where a mode will rest, and the force that is not elastic, (n, 2).
    """

    modes: Floats
    to_modes: Floats
    squares: Floats
    motions: Floats
    begin: Floats
    beside: Floats


def stop_path(mass: Floats, stiffness: Floats, dt: float) -> StopPath:
    """Find the motions to rest in one period of the slowest mode of a specimen."""
    squares, modes = eigh(stiffness, mass)
    squares = np.maximum(squares, (2.0 * math.pi / LONGEST) ** 2)
    steps = math.ceil(max(SHORTEST, 2.0 * math.pi / math.sqrt(squares[0])) / dt - 1e-9)
    motions = np.empty((len(squares), steps + 1, 3, 3))
    t = dt * np.arange(steps + 1)
    for motion, w in zip(motions, np.sqrt(squares).tolist(), strict=True):
        wave, zero = np.exp(1j * w * t), 0.0 * t
        waves = [np.array([(1j * w) ** k * wave, ((1j * w) ** k * t + k * (1j * w) ** (k - 1)) * wave]) for k in range(3)]
        lines = [(zero + 1.0, t), (zero, zero + 1.0), (zero, zero)]
        of_all = np.array([[*line, *each.real, *each.imag] for line, each in zip(lines, waves, strict=True)])
        ends = np.vstack([of_all[:, :, 0], of_all[:, :, -1]])
        scale = np.abs(ends).max(axis=0)
        weights = np.linalg.inv(ends / scale)[:, :3] / scale[:, np.newaxis]
        motion[:] = of_all.transpose(2, 0, 1) @ weights
    n = len(squares)
    return StopPath(
        modes, np.linalg.inv(modes), squares, motions, np.zeros((n, 3)), np.zeros((n, 2))
    )

RULE = int(__import__("os").environ.get("WS_RULE", "1"))

@compiled
def come_to_rest(p: StopPath, plan: Floats, dt: float, path: Floats) -> None:
    """Bring a target to rest, at a place where the specimen's force is 0.

    The specimen unloads as the assumed one, or, where it is stiffer, to where the test has begun.

    Parameters
    ----------
    p : StopPath
        Of the specimen.
    plan : ndarray
        Displacement, velocity and force of the target at a step and the coming ones, (p, 3, n).
    dt : float
        Sampling period, s.
    path : ndarray
        The target on its way to rest at the same step and the coming ones, shape (m, 3, n). The
        result.
    """
    n, steps = len(p.squares), p.motions.shape[1] - 1
    for m in range(n):
        x = v = a = f = 0.0
        for i in range(n):
            x += p.to_modes[m, i] * plan[0, 0, i]
            v += p.to_modes[m, i] * plan[0, 1, i]
            a += p.to_modes[m, i] * planned_acceleration(plan, i, dt)
            f += p.modes[i, m] * plan[0, 2, i]
        back = (f - a) / p.squares[m]
        if RULE == 1 and back * x > 0.0 and abs(back) > abs(x):
            back = x
        if RULE == 2 and back * x > 0.0 and abs(back) > abs(x):
            back = x
        if RULE == 2 and back * x < 0.0:
            back = 0.0
        p.begin[m, 0], p.begin[m, 1], p.begin[m, 2] = back, v, a
        p.beside[m, 0], p.beside[m, 1] = x - back, f - a - p.squares[m] * back
    path[:] = 0.0
    for j in range(len(path)):
        k = min(j, steps)
        for m in range(n):
            motion, begin = p.motions[m, k], p.begin[m]
            q = motion[0, 0] * begin[0] + motion[0, 1] * begin[1] + motion[0, 2] * begin[2]
            v = motion[1, 0] * begin[0] + motion[1, 1] * begin[1] + motion[1, 2] * begin[2]
            a = motion[2, 0] * begin[0] + motion[2, 1] * begin[1] + motion[2, 2] * begin[2]
            f = a + p.squares[m] * q + left_open(k, steps) * p.beside[m, 1]
            for i in range(n):
                path[j, 0, i] += p.modes[i, m] * (q + p.beside[m, 0])
                path[j, 1, i] += p.modes[i, m] * v
                path[j, 2, i] += p.to_modes[m, i] * f
