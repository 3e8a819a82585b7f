"""Feedback through oil columns, valves and dead times: the regulator of their identified model.

With the deviations x and v of the specimen from its plan, c = f / k_oil of the oil's compression
and w of the valves' flow, which follows the commands u (as flows) through valve and dead time::

    M v' = k_oil c - K x,    c' = w - v - lambda c                                          (5)

The commands minimise the sum of x^2 + (a / W^2)^2 + (u / g)^2 over all future samples, with the
acceleration a = v' (the linear-quadratic regulator: Kalman 1960; Anderson & Moore, Optimal Control,
1990). In stiff oil, x' = w, such a loop crosses over near g. In soft oil a flow moves the specimen
less, the faster it changes. With

    g = (1 + (K + M W^2) / k_oil) W                                                         (6)

the loop crosses over near W, whatever the oil column is. An oil column that rings moves the
specimen little, and accelerates it: hence the second term. What damps it is a flow at the right
time. With a delay that is unknown by s, it does so in the mean by E exp(i w delay) =
exp(-(s w)^2 / 2) at the frequency w. The acceleration of each mode counts by that factor.

The oil's compression is fed back as a part of the volume x + c, which is passive with any specimen,
and the rest as the acceleration M a = k_oil c - K x. Of a specimen that sticks, and is stiffer by
far than K, the force tells nothing about ringing.
"""

import math
from collections.abc import Sequence

import numpy as np
from scipy.linalg import eigh
from seft_msgs_py.arrays import Floats
from seft_msgs_py.errors import InputError
from seft_plant_sim.judge.valve_following import UNCERTAIN_DELAY
from seft_plant_sim.judge.valve_model import ValveModel
from seft_plant_sim.lti import first_order_hold, split_dead_time

CROSSOVER = math.pi / 4
"""Of the loop, times the delay of the valve that it may have: half the value at which a loop of a
delay alone, without a model of it, would oscillate."""
UNKNOWN_PHASE = math.pi / 18
"""Of the loop at its crossover, at most, by a valve whose delay is as wrong as it may be: ten
degrees. Of a fast valve, what is not known is most of the delay."""
STIFF = 10.0
"""Frequency of an oil column over that of the valve, beyond which it counts as stiff. So does one
with a mass that is not known, which is 0: what is fed back is then the volume x + c."""

STOOD = 3.0
"""Square of the delay's error that the damping of ringing must stand, over its variance: that of
the largest one of an even distribution."""

ELASTIC = 0.5
"""Part of the specimen's stiffness that the regulator counts on: halfway between a specimen that is
elastic and one that yields."""

_NONE = (
    "force_controller: no regulator brings this specimen back to its plan; check /**: actuator.* "
    "and specimen.*"
)
_DOUBLINGS, _CONVERGED = 60, 1e-14  # of the samples that are looked ahead: 9 to 14 are usual


def crossover(valves: Sequence[ValveModel]) -> Floats:
    """Crossover frequency of the loop of each valve, W of Eq. (6), shape (n,), rad/s."""
    return fastest_feedback(np.array([valve.delay for valve in valves]))


def fastest_feedback(delay: Floats) -> Floats:
    """Crossover frequency that delays of loops allow, s and rad/s, shape (n,)."""
    return np.minimum(CROSSOVER / (delay + UNCERTAIN_DELAY), UNKNOWN_PHASE / UNCERTAIN_DELAY)


def regulator(
    valves: Sequence[ValveModel],
    oil: Floats,
    mass: Floats,
    stiffness: Floats,
    memory: int,
    dt: float,
) -> tuple[Floats, Floats]:
    """Gains that bring n axes back to their plan, see Eq. (5).

    Parameters
    ----------
    valves : sequence of ValveModel
        Of the axes.
    oil : ndarray
        Stiffness (N/m) and leakage (1/s) of each axis, shape (n, 2).
    mass, stiffness : ndarray
        Of the specimen, shape (n, n), kg and N/m.
    memory : int
        Number of past commands that are used.
    dt : float
        Sampling period, s.

    Returns
    -------
    gains : ndarray
        Flow per deviation of displacement (m), velocity (m/s), acceleration (m/s^2) and compression
        (m), shape (n, 4, n).
    sent : ndarray
        Flow per deviation of past commands, the newest first, shape (n, n, memory).

    Raises
    ------
    InputError
        If there are none.
    """
    n, stiffness = len(valves), ELASTIC * stiffness
    if np.linalg.eigvalsh(stiffness + np.diag(oil[:, 0])).min() <= 0.0:
        raise InputError(_NONE)  # the specimen pushes harder than the oil holds
    mass, certain = _modes(mass, stiffness + np.diag(oil[:, 0]), valves, dt)
    free, push = _sampled(valves, oil, mass, stiffness, dt)
    w = crossover(valves)
    least = np.linalg.inv((np.eye(n) + (stiffness + mass * w**2) / oil[:, :1]) * w)  # of g
    by_x, by_c = np.split(np.linalg.solve(mass, np.hstack([-stiffness, np.diag(oil[:, 0])])), 2, 1)
    rough = np.zeros((n, len(free)))  # the acceleration as a displacement
    rough[:, :n], rough[:, 2 * n : 3 * n] = certain @ by_x, certain @ by_c
    rough /= w[:, np.newaxis] ** 2
    cost, effort = rough.T @ rough, least.T @ least
    cost[:n, :n] += np.eye(n)
    p = cost_to_go(free, push, cost, effort)
    gain = np.linalg.solve(effort + push.T @ p @ push, push.T @ p @ free)
    # of the flow and the commands under way, which past commands have made
    state, own, sent = push[3 * n :], free[3 * n :, 3 * n :], np.empty((n, n, memory))
    for j in range(memory):
        sent[:, :, j] = gain[:, 3 * n :] @ state
        state = own @ state
    x, v, c = gain[:, : 3 * n].reshape(n, 3, n).transpose(1, 0, 2)
    a = np.linalg.solve(by_c.T, (c - x).T).T
    return np.stack([x - a @ by_x, v * dt, a, x], axis=1), sent


def cost_to_go(a: Floats, b: Floats, q: Floats, r: Floats) -> Floats:
    """Solve the discrete algebraic Riccati equation, by doubling (Chu, Fan & Lin 2004).

    `scipy.linalg.solve_discrete_are` reorders a Schur form, which fails with the many eigenvalues 0
    of dead times, and takes minutes.
    """
    g, h, one = b @ np.linalg.solve(r, b.T), q, np.eye(len(a))
    for _ in range(_DOUBLINGS):
        both = np.linalg.solve(one + g @ h, np.hstack([a, g]))
        next_a, by_g = both[:, : len(a)], both[:, len(a) :]
        more = a.T @ h @ next_a
        g, h, a = _symmetric(g + a @ by_g @ a.T), _symmetric(h + more), a @ next_a
        if np.abs(more).max() <= _CONVERGED * np.abs(h).max():
            return h
    raise InputError(_NONE)


def _symmetric(matrix: Floats) -> Floats:
    return 0.5 * (matrix + matrix.T)


def _modes(
    mass: Floats, stiffness: Floats, valves: Sequence[ValveModel], dt: float
) -> tuple[Floats, Floats]:
    """Masses without modes that are faster than `STIFF` says; certain part of accelerations.

    A command answers a sample up to half a period more or less late.
    """
    fastest = STIFF * max(valve.natural for valve in valves)
    squares, shapes = eigh(mass, stiffness)  # 1/w^2: 0 of a mass that is 0
    back, squares = np.linalg.inv(shapes), np.maximum(squares, fastest**-2.0)
    certain = np.exp(-0.5 * STOOD * (UNCERTAIN_DELAY**2 + 0.25 * dt**2) / squares)
    return back.T @ (squares[:, np.newaxis] * back), shapes @ (certain[:, np.newaxis] * back)


def _sampled(
    valves: Sequence[ValveModel], oil: Floats, mass: Floats, stiffness: Floats, dt: float
) -> tuple[Floats, Floats]:
    """Matrices from the states and the commands of a sample to the states of the next.

    The states are x, v dt, c, w and w' dt of all axes, all lengths per period, then the commands
    under way of each axis, the newest first.
    """
    n, one = len(valves), np.eye(len(valves))
    natural = np.array([valve.natural for valve in valves])
    damping = np.array([valve.damping for valve in valves])
    x, v, c, flow, rate = (slice(k * n, k * n + n) for k in range(5))
    a, b = np.zeros((5 * n, 5 * n)), np.zeros((5 * n, n))
    a[x, v] = a[flow, rate] = a[c, flow] = one
    a[v, x], a[v, c] = -np.linalg.solve(mass, stiffness), np.linalg.solve(mass, np.diag(oil[:, 0]))
    a[c, v], a[c, c] = -one, -np.diag(oil[:, 1])
    a[rate, flow], a[rate, rate] = -np.diag(natural**2), -np.diag(2.0 * damping * natural)
    b[rate] = np.diag(natural**2)
    unit = np.repeat(dt ** np.array([0.0, 1.0, 0.0, 0.0, 1.0]), n)
    a, b = a * unit[:, np.newaxis] / unit, b * unit[:, np.newaxis]
    delays = [split_dead_time(valve.late, dt) for valve in valves]
    lines = np.cumsum([5 * n, *(whole + 1 for whole, _ in delays)])
    free, push = np.zeros((lines[-1], lines[-1])), np.zeros((lines[-1], n))
    for i, (whole, remainder) in enumerate(delays):
        early, forced_early, _ = first_order_hold(a, b[:, i : i + 1], remainder)
        after, forced_late, _ = first_order_hold(a, b[:, i : i + 1], dt - remainder)
        free[: 5 * n, : 5 * n] = after @ early
        line = int(lines[i])
        # the commands that act in a period are so many periods old; 0 is the one to come
        for old, part in ((whole, forced_late), (whole + 1, after @ forced_early)):
            acts = free[: 5 * n, line + old - 1] if old else push[: 5 * n, i]
            acts += part[:, 0]
        push[line, i] = 1.0
        free[line + 1 : line + whole + 1, line : line + whole] = np.eye(whole)
    return free, push
