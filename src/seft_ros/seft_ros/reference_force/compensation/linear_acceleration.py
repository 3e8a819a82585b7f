"""Prediction with an acceleration that varies linearly over the delay."""

import numpy as np
import numpy.typing as npt

from seft_ros.reference_force.compensation.compensator import Compensator, Knowledge
from seft_ros.reference_force.compensation.delay.delay_schedule import DelayFilter, compensate_delay
from seft_ros.reference_force.compensation.delay.signals import Signals
from seft_ros.reference_force.compensation.delay.varying_filter import Memory

Floats = npt.NDArray[np.float64]


def linear_acceleration(knowledge: Knowledge) -> Compensator:
    """f_r(t) = -(M_e + M_c) a_g(t + tau) - M_c a+, with a+ the acceleration predicted for t + tau.

    After Horiuchi & Konno (2001, Phil. Trans. R. Soc. A 359:1893-1909), who let the acceleration
    vary linearly over the delay, so that displacement and velocity at its end are (Newmark's
    method with beta = 1/6)::

        x+ = x + tau v + tau^2 (2 a + a+) / 6,    v+ = v + tau (a + a+) / 2

    Here a+ closes the equation of motion of the whole structure at t + tau, where the ground
    motion is known, instead of being extrapolated::

        (M_e + M_c) a+ + C v+ + K x+ = -(M_e + M_c) a_g(t + tau)
    """
    return compensate_delay(knowledge, _design)


def _design(knowledge: Knowledge, longest: int) -> DelayFilter:
    signals = Signals(knowledge, preview=longest)
    mass, damping, stiffness = knowledge.total_mass, knowledge.damping, knowledge.stiffness

    def gains(delay: float) -> Floats:
        x, v, a = signals.displacement, signals.velocity, signals.acceleration
        load = -mass @ signals.ground_motion(delay)
        free = damping @ (v + delay / 2 * a) + stiffness @ (x + delay * v + delay**2 / 3 * a)
        effective = mass + delay / 2 * damping + delay**2 / 6 * stiffness
        force: Floats = load - knowledge.computed_mass @ np.linalg.solve(effective, load - free)
        return force

    return DelayFilter(Memory.none(knowledge.axes), gains)
