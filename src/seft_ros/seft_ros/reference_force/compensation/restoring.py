"""The algebraic loop of the acceleration feedback, solved."""

import numpy as np

from seft_ros.reference_force.compensation.compensator import Compensator, Knowledge
from seft_ros.reference_force.compensation.linear_filter import LinearCompensator, LinearFilter


def restoring(knowledge: Knowledge) -> Compensator:
    """f_r = -M_e a_g + M_c (M_e + M_c)^-1 r, with the measured restoring force r = f - M_e a.

    With M_e a + r = f_r put into Eq. 2.5 for the acceleration that the force will cause: the
    same force where the actuator is ideal, but the feedback ends with the specimen's own
    stiffness and damping instead of its mass, so that the loop gain falls with frequency and
    stays below one. Needs no model beyond the mass.
    """
    n = knowledge.axes
    share = knowledge.computed_mass @ np.linalg.inv(knowledge.total_mass)
    measured = np.zeros((n, 4 * n))
    measured[:, 2 * n : 3 * n] = -share @ knowledge.mass
    measured[:, 3 * n :] = share
    return LinearCompensator(LinearFilter.of_gains(measured, -knowledge.mass))
