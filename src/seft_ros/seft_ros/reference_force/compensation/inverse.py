"""First-order inverse of the actuator."""

import numpy as np
import numpy.typing as npt

from seft_ros.reference_force.compensation.compensator import Compensator, Knowledge
from seft_ros.reference_force.compensation.delay.delay_schedule import DelayFilter, compensate_delay
from seft_ros.reference_force.compensation.delay.signals import Signals
from seft_ros.reference_force.compensation.delay.varying_filter import Memory

Floats = npt.NDArray[np.float64]


def inverse(knowledge: Knowledge) -> Compensator:
    """f_r[k] = -M_e a_g(t + tau) + S (alpha_c r[k] - (alpha_c - 1) r[k-1]), S = M_c (M_e + M_c)^-1.

    The actuator is taken as G(z) = z / (alpha_c z - (alpha_c - 1)), which comes nearer by one
    alpha_c-th of the distance in each step, and the command is passed through its inverse (Chen
    & Ricles 2009, Eng. Struct. 31:2643-2655). G lags by alpha_c - 1 steps, hence
    alpha_c = 1 + tau / dt. The command is that of the solved loop, see `restoring`: with the
    acceleration itself the inverse would make the feedback of high frequencies 2 alpha_c - 1
    times as large. The ground motion needs no inverse, as it is known ahead.
    """
    return compensate_delay(knowledge, _design)


def _design(knowledge: Knowledge, longest: int) -> DelayFilter:
    n = knowledge.axes
    signals = Signals(knowledge, preview=longest, blocks=1)  # of r[k-1]
    share = knowledge.computed_mass @ np.linalg.inv(knowledge.total_mass)

    def gains(delay: float) -> Floats:
        lead = delay / knowledge.dt
        r, before = signals.restoring_force, signals.state(0)
        ground = knowledge.mass @ signals.ground_motion(delay)
        force: Floats = -ground + share @ (r + lead * (r - before))
        return force

    measured = np.hstack([np.zeros((n, 2 * n)), -knowledge.mass, np.eye(n), np.zeros((n, n))])
    return DelayFilter(Memory.past(measured, 1), gains)
