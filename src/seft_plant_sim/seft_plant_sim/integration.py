"""Integration of a continuous model between samples, compiled."""

import math
from typing import NamedTuple

import numpy as np
from seft_msgs_py.config.arrays import Floats, Ints
from seft_msgs_py.errors import InputError

from seft_plant_sim.actuator import FASTEST, holding_force, lost_opening
from seft_plant_sim.compiled import compiled, multiply
from seft_plant_sim.continuous_model import ContinuousModel
from seft_plant_sim.lti import first_order_hold
from seft_plant_sim.spring_laws import (
    BESIDE,
    GAP,
    HYSTERETIC,
    KIND,
    MEMORY,
    SLIDER,
    STIFFNESS,
    WIDTH,
    spring_force,
)

LONGEST_STEP = 5e-4  # s
STEP_TIMES_RATE = 0.5  # of the fastest residual
MAX_STEPS = 500


class Dynamics(NamedTuple):
    """A `ContinuousModel` of n axes, s states and r residuals over two stretches of time.

    Within a stretch the drive does not change. It is taken in equal steps by the exponential
    Runge-Kutta scheme ETD2RK (Cox & Matthews 2002, Eq. 22): the linear part, which holds the fast
    oil column and the valve, is solved exactly, so that a linear model needs one step.

    Attributes
    ----------
    predict : ndarray
        Shape (2, s + n + r, s): takes (z, drive, residuals) to the state after one step if the
        residuals stay as they are.
    correct : ndarray
        Shape (2, r, s): what a change of the residuals in the step adds.
    steps : ndarray
        Number of steps of each stretch, shape (2,); 0 where its time is none.
    period : ndarray
        Length of a step, shape (2,), s.
    output : ndarray
        Shape (s + n + r, 4n): takes (z, drive, residuals) to the outputs.
    pistons, laws, deformation : ndarray
        Of the model.
    """

    predict: Floats
    correct: Floats
    steps: Ints
    period: Floats
    output: Floats
    pistons: Floats
    laws: Floats
    deformation: Floats


class Motion(NamedTuple):
    """Where a model is.

    Attributes
    ----------
    work : ndarray
        State, drive and residuals, shape (s + n + r,).
    springs : ndarray
        What the springs remember, shape (p, `spring_laws.MEMORY`).
    state, residuals, trial : ndarray
        Room for the next state, residuals and memories.
    """

    work: Floats
    springs: Floats
    state: Floats
    residuals: Floats
    trial: Floats


def dynamics_of(
    model: ContinuousModel, before: float, after: float, longest: float = 0.0
) -> Dynamics:
    """Make it of a model, for two stretches of time in s, in steps of at most ``longest`` s.

    0 stands for `LONGEST_STEP`.

    Raises
    ------
    InputError
        If a residual is too fast to be followed.
    """
    fastest, longest = _fastest(model), longest or LONGEST_STEP
    if fastest * longest > STEP_TIMES_RATE:
        longest = STEP_TIMES_RATE / fastest
        if max(before, after) > MAX_STEPS * longest:
            raise InputError(
                f"rig: friction, end stops or springs answer at {fastest:.3g} 1/s, too fast to be "
                "followed; raise actuator.friction_velocity, or check mass, oil_stiffness and "
                "springs"
            )
    stretches = [_stretch(model, time, longest) for time in (before, after)]
    predict, correct, steps, periods = zip(*stretches, strict=True)
    output = np.hstack([model.c, model.d, model.outputs]).T
    arrays = (output, model.pistons, _laws(model), model.deformation)
    by_stretch = np.array(predict), np.array(correct), np.array(steps, dtype=np.int64)
    return Dynamics(*by_stretch, np.array(periods), *map(np.ascontiguousarray, arrays))


def at_rest(dynamics: Dynamics) -> Motion:
    """Motion of a model that has not been driven."""
    p, (_, r, s) = len(dynamics.laws), dynamics.correct.shape
    work = np.zeros(len(dynamics.output))
    return Motion(work, np.zeros((p, MEMORY)), np.zeros(s), np.zeros(r), np.zeros((p, MEMORY)))


@compiled
def integrate(dynamics: Dynamics, stretch: int, motion: Motion) -> None:
    """Take a motion through one of the stretches, under the drive that is in it."""
    work, state, residuals = motion.work, motion.state, motion.residuals
    s, r = len(state), len(residuals)
    start = len(work) - r
    predict, correct = dynamics.predict[stretch], dynamics.correct[stretch]
    for half in range(2 * dynamics.steps[stretch]):
        memory = motion.springs
        if half % 2 == 0:  # where it would go if the residuals stayed as they are
            multiply(predict, work, state)
            memory = motion.trial
            for j in range(len(memory)):
                for i in range(MEMORY):
                    memory[j, i] = motion.springs[j, i]
        else:  # where it goes as they change
            for j in range(r):
                change = residuals[j] - work[start + j]
                for i in range(s):
                    state[i] += correct[j, i] * change
        if r:
            _residuals(dynamics, dynamics.period[stretch], motion, memory)
        if half % 2:
            for i in range(s):
                work[i] = state[i]
            for j in range(r):
                work[start + j] = residuals[j]


@compiled
def _residuals(dynamics: Dynamics, period: float, motion: Motion, memory: Floats) -> None:
    """Find the residuals at the next state, to which the springs go by way of where they turn."""
    last, z, residuals = motion.work, motion.state, motion.residuals
    n, m = dynamics.output.shape[1] // 4, len(dynamics.pistons)
    for i in range(m):
        residuals[i] = lost_opening(dynamics.pistons, i, z[3 * n + i], z[2 * n + i])
        residuals[m + i] = holding_force(dynamics.pistons, i, z[i], z[n + i])
    for j in range(len(dynamics.laws)):
        e = v_0 = v_1 = 0.0
        for i in range(n):
            factor = dynamics.deformation[j, i]
            e += factor * z[i]
            v_0 += factor * last[n + i]
            v_1 += factor * z[n + i]
        if v_0 * v_1 < 0.0:  # it turns where the velocity, taken as linear, is 0
            turn = memory[j, 0] + 0.5 * period * v_0 * v_0 / (v_0 - v_1)
            spring_force(dynamics.laws, j, memory, turn)
        force = spring_force(dynamics.laws, j, memory, e)
        residuals[2 * m + j] = force - dynamics.laws[j, STIFFNESS] * e


def _laws(model: ContinuousModel) -> Floats:
    return np.array([spring.law for spring in model.springs]).reshape(-1, WIDTH)


def _fastest(model: ContinuousModel) -> float:
    """Largest rate at which a residual answers a state, 1/s: a step must be shorter."""
    rates = model.pistons[:, FASTEST].tolist()
    n, first = model.b.shape[1], 2 * len(model.pistons)
    for j, law in enumerate(_laws(model)):
        if law[KIND] in (SLIDER, GAP):
            stiffer = law[BESIDE] + law[HYSTERETIC] - law[STIFFNESS]
            per_force = -model.deformation[j] @ model.inputs[n : 2 * n, first + j]
            rates.append(math.sqrt(max(0.0, stiffer * per_force)))
    return max(rates, default=0.0)


def _stretch(
    model: ContinuousModel, time: float, longest: float
) -> tuple[Floats, Floats, int, float]:
    """Give predict, correct, steps and period of a stretch."""
    steps = math.ceil(time / longest * (1 - 1e-9))
    if model.is_linear:
        steps = min(steps, 1)
    h = time / max(1, steps)
    free, start, change = first_order_hold(model.a, np.hstack([model.b, model.inputs]), h)
    residuals = change[:, model.b.shape[1] :]
    predict = np.ascontiguousarray(np.hstack([free, start]).T)
    return predict, np.ascontiguousarray(residuals.T), steps, h
