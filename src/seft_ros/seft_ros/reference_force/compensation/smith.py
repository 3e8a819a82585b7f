"""Smith predictor: the model's response without delay is fed back."""

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm
from seft_msgs_py.errors import InputError

from seft_ros.reference_force.compensation.compensator import Compensator, Knowledge
from seft_ros.reference_force.compensation.delay.delay_schedule import DelayFilter, compensate_delay
from seft_ros.reference_force.compensation.delay.signals import Signals, between_samples
from seft_ros.reference_force.compensation.delay.varying_filter import Memory

Floats = npt.NDArray[np.float64]

_AT_REST = 1 - 1e-7  # least decay of the model's slowest mode in a step


def smith(knowledge: Knowledge) -> Compensator:
    """f_r(t) = -M_e a_g(t + tau) + S (r_s(t) + r(t) - r_s(t - tau)), S = M_c (M_e + M_c)^-1.

    Smith (1959, ISA J. 6:2, 28-33): fed back is the response of a model of the specimen to the
    reference force without delay, corrected by the measured response less that of the delayed
    model. Where the model is right the delay is outside the loop.

    The loop without delay is algebraic, M_e a_s + r_s = f_r and f_r = -(M_e + M_c) a_g - M_c a_s,
    and solved as in `restoring`; the correction is that of the restoring force r = f - M_e a for
    the same reason. The model's restoring force is r_s = C v_s + K x_s, with x_s and v_s exact for
    a force that varies linearly from step to step.
    """
    return compensate_delay(knowledge, _design)


def _design(knowledge: Knowledge, longest: int) -> DelayFilter:
    n = knowledge.axes
    signals = Signals(knowledge, preview=longest, blocks=2 + longest)
    free, before, at = _specimen(knowledge)
    share = knowledge.computed_mass @ np.linalg.inv(knowledge.total_mass)
    restoring = np.hstack([knowledge.stiffness, knowledge.damping])
    # the model at this step is (states) + at f_r; its past restoring forces, the newest first
    known = restoring @ np.vstack([signals.state(0), signals.state(1)])
    direct = restoring @ at

    def gains(delay: float) -> Floats:
        weights = between_samples(delay / knowledge.dt, 1 + longest)
        delayed = sum(w * signals.state(2 + i) for i, w in enumerate(weights[1:]))
        now = 1 - weights[0]
        ground = knowledge.mass @ signals.ground_motion(delay)
        force = -ground + share @ (now * known + signals.restoring_force - delayed)
        solved: Floats = np.linalg.solve(np.eye(n) - now * share @ direct, force)
        return solved

    size = (2 + longest) * n
    a = np.eye(size, k=-n)
    a[: 2 * n] = 0.0
    a[: 2 * n, : 2 * n] = free
    a[2 * n : 3 * n] = known[:, :size]
    w = np.vstack([free @ at + before, direct, np.zeros((size - 3 * n, n))])
    return DelayFilter(Memory(a, np.zeros((size, 4 * n)), np.zeros((size, n)), w), gains)


def _specimen(knowledge: Knowledge) -> tuple[Floats, Floats, Floats]:
    """Transition of (x_s, v_s) over a step: free z + before f_r[k] + at f_r[k+1].

    Raises
    ------
    InputError
        If the specimen does not come to rest by itself.
    """
    n, dt = knowledge.axes, knowledge.dt
    inverse = np.linalg.inv(knowledge.mass)
    # z, the force and its slope times dt
    system = np.zeros((4 * n, 4 * n))
    system[:n, n : 2 * n] = np.eye(n)
    system[n : 2 * n, : 3 * n] = inverse @ np.hstack(
        [-knowledge.stiffness, -knowledge.damping, np.eye(n)]
    )
    system[2 * n : 3 * n, 3 * n :] = np.eye(n) / dt
    free, held, slope = np.split(expm(system * dt)[: 2 * n], [2 * n, 3 * n], axis=1)
    if np.abs(np.linalg.eigvals(free)).max() > _AT_REST:
        raise InputError(
            "reference_force: compensation.method smith needs a model that comes to rest by "
            "itself; give model.damping and model.stiffness above zero on every axis"
        )
    return free, held - slope, slope
