"""No compensation: the measured acceleration as it is."""

import numpy as np

from seft_ros.reference_force.compensation.compensator import Compensator, Knowledge
from seft_ros.reference_force.compensation.linear_filter import LinearCompensator, LinearFilter


def none(knowledge: Knowledge) -> Compensator:
    """f_r = -(M_e + M_c) a_g - M_c a (paper Eq. 5.3)."""
    n = knowledge.axes
    measured = np.zeros((n, 4 * n))
    measured[:, 2 * n : 3 * n] = -knowledge.computed_mass
    return LinearCompensator(LinearFilter.of_gains(measured, -knowledge.total_mass))
