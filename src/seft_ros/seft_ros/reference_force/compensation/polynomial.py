"""Polynomial extrapolation of the measured acceleration."""

import numpy as np
import numpy.typing as npt

from seft_ros.reference_force.compensation.compensator import Compensator, Knowledge
from seft_ros.reference_force.compensation.delay.delay_schedule import DelayFilter, compensate_delay
from seft_ros.reference_force.compensation.delay.signals import Signals
from seft_ros.reference_force.compensation.delay.varying_filter import Memory

Floats = npt.NDArray[np.float64]


def polynomial(knowledge: Knowledge) -> Compensator:
    """f_r(t) = -(M_e + M_c) a_g(t + tau) - M_c sum_j l_j a(t - j p).

    The l_j are the weights of Lagrange's polynomial of order N through the last N + 1
    accelerations, a spacing p apart, for the instant t + tau. Horiuchi et al. (1996, 11WCEE,
    paper 660) space them by the delay itself, p = tau, where the weights are 2, -1 or 3, -3, 1 or
    4, -6, 4, -1; here p is the nearest whole number of steps, at least one.
    """
    return compensate_delay(knowledge, _design)


def _design(knowledge: Knowledge, longest: int) -> DelayFilter:
    n, dt = knowledge.axes, knowledge.dt
    order = knowledge.options["compensation.order"]
    blocks = order * longest  # past accelerations, the newest first
    signals = Signals(knowledge, preview=longest, blocks=blocks)

    def gains(delay: float) -> Floats:
        spacing = max(1, round(delay / dt))
        past = [signals.acceleration]
        past += [signals.state(j * spacing - 1) for j in range(1, order + 1)]
        weights = lagrange_weights(delay / (spacing * dt), order)
        predicted = sum(weight * a for weight, a in zip(weights, past, strict=True))
        ground = knowledge.total_mass @ signals.ground_motion(delay)
        force: Floats = -ground - knowledge.computed_mass @ predicted
        return force

    measured = np.eye(n, 5 * n, k=2 * n)
    return DelayFilter(Memory.past(measured, blocks), gains)


def lagrange_weights(ahead: float, order: int) -> Floats:
    """Weights of the values at 0, -1, ... -order for the polynomial's value at ``ahead``."""
    nodes = -np.arange(order + 1.0)
    weights = np.ones(order + 1)
    for j in range(order + 1):
        others = np.delete(nodes, j)
        weights[j] = np.prod((ahead - others) / (nodes[j] - others))
    return weights
