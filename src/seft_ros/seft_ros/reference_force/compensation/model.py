"""Prediction with a model of the whole structure (paper, section 6)."""

import math

import numpy as np
import numpy.typing as npt

from seft_ros.reference_force.compensation.compensator import Compensator, Knowledge
from seft_ros.reference_force.compensation.delay.delay_schedule import DelayFilter, compensate_delay
from seft_ros.reference_force.compensation.delay.signals import Signals, whole_steps
from seft_ros.reference_force.compensation.delay.varying_filter import Memory

Floats = npt.NDArray[np.float64]

_FINE = 0.2  # rad: phase of the fastest mode in a step; its frequency errs by a 24th of the square


def model(knowledge: Knowledge) -> Compensator:
    """f_r(t) = -(M_e + M_c) a_g(t + tau) - M_c a+, with a+ the acceleration predicted for t + tau.

    Model-based compensation (Carrion & Spencer 2007, NSEL report 6; section 6 of the paper): the
    measured displacement and velocity are the initial conditions of ::

        (M_e + M_c) a + C v + K x = -(M_e + M_c) a_g

    which the central-difference method solves up to t + tau under the known coming ground
    motion, in equal steps of at most a sampling period that are short for the fastest mode.
    """
    return compensate_delay(knowledge, _design)


def _design(knowledge: Knowledge, longest: int) -> DelayFilter:
    signals = Signals(knowledge, preview=longest)
    mass, damping, stiffness = knowledge.total_mass, knowledge.damping, knowledge.stiffness
    squares = np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real
    fastest = math.sqrt(squares.max(initial=0.0))

    def load(time: float) -> Floats:
        return -mass @ signals.ground_motion(time)

    def gains(delay: float) -> Floats:
        count = max(whole_steps(delay, knowledge.dt), math.ceil(fastest * delay / _FINE))
        h = delay / count
        x, v = signals.displacement, signals.velocity
        a = np.linalg.solve(mass, load(0.0) - damping @ v - stiffness @ x)
        last = x - h * v + h**2 / 2 * a
        effective = mass / h**2 + damping / (2 * h)
        for i in range(count + 1):  # one step beyond, for the acceleration at t + tau
            known = stiffness @ x - mass / h**2 @ (2 * x - last) - damping / (2 * h) @ last
            oldest, last, x = last, x, np.linalg.solve(effective, load(i * h) - known)
        a = (x - 2 * last + oldest) / h**2
        force: Floats = load(delay) - knowledge.computed_mass @ a
        return force

    return DelayFilter(Memory.none(knowledge.axes), gains)
