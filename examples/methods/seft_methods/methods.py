"""The methods at a given or estimated delay, each by its equation.

``tau`` is the delay that is compensated, r = f - M_e a the measured restoring force, and
S = M_c (M_e + M_c)^-1.
"""

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.errors import InputError
from seft_plant_sim.lti import first_order_hold
from seft_ros.reference_force.compensation_methods import between_samples
from seft_ros.reference_force.compensator import MethodInputs

from seft_methods.adaptation import DelayFilter, delay_method
from seft_methods.settings import Settings
from seft_methods.signals import Memory, Signals

_AT_REST = 1 - 1e-7  # least decay of the model's slowest mode in a step


@delay_method
def polynomial(inputs: MethodInputs, longest: int, settings: Settings) -> DelayFilter:
    """f_r(t) = -(M_e + M_c) a_g(t + tau) - M_c sum_j l_j a(t - j p).

    The l_j are the weights of Lagrange's polynomial of order N through the last N + 1
    accelerations, at a spacing p, for the instant t + tau. In Horiuchi et al. (1996, 11WCEE, paper
    660) the spacing is the delay itself, p = tau, with weights 2, -1 or 3, -3, 1 or 4, -6, 4, -1;
    here p is the nearest whole number of steps, at least one.
    """
    n, dt = inputs.axes, inputs.dt
    order = settings["order"]
    blocks = order * longest  # past accelerations, the newest first
    signals = Signals(inputs, preview=longest, blocks=blocks)

    def gains(delay: float) -> Floats:
        spacing = max(1, round(delay / dt))
        past = [signals.measured[2]]
        past += [signals.state(j * spacing - 1) for j in range(1, order + 1)]
        weights = lagrange_weights(delay / (spacing * dt), order)
        predicted = sum(weight * a for weight, a in zip(weights, past, strict=True))
        ground = inputs.total_mass @ signals.ground_motion(delay)
        return np.asarray(-ground - inputs.computed_mass @ predicted)

    return Memory.past(np.eye(n, 5 * n, k=2 * n), blocks), gains


def lagrange_weights(ahead: float, order: int) -> Floats:
    """Weights of the values at 0, -1, ... -order for the polynomial's value at ``ahead``."""
    nodes = -np.arange(order + 1.0)
    weights = np.ones(order + 1)
    for j in range(order + 1):
        others = np.delete(nodes, j)
        weights[j] = np.prod((ahead - others) / (nodes[j] - others))
    return weights


@delay_method
def linear_acceleration(inputs: MethodInputs, longest: int, _: Settings) -> DelayFilter:
    """f_r(t) = -(M_e + M_c) a_g(t + tau) - M_c a+, with a+ the acceleration predicted for t + tau.

    After Horiuchi & Konno (2001, Phil. Trans. R. Soc. A 359:1893-1909): the acceleration varies
    linearly over the delay, so that displacement and velocity at its end are (Newmark's method with
    beta = 1/6)::

        x+ = x + tau v + tau^2 (2 a + a+) / 6,    v+ = v + tau (a + a+) / 2

    Here a+ is not extrapolated, but follows from the equation of motion of the whole structure at
    t + tau, for which the ground motion is known::

        (M_e + M_c) a+ + C v+ + K x+ = -(M_e + M_c) a_g(t + tau)
    """
    signals = Signals(inputs, preview=longest)
    mass, damping, stiffness = inputs.total_mass, inputs.damping, inputs.stiffness

    def gains(delay: float) -> Floats:
        x, v, a, _ = signals.measured
        load = -mass @ signals.ground_motion(delay)
        free = damping @ (v + delay / 2 * a) + stiffness @ (x + delay * v + delay**2 / 3 * a)
        effective = mass + delay / 2 * damping + delay**2 / 6 * stiffness
        a_plus = np.linalg.solve(effective, load - free)
        return np.asarray(load - inputs.computed_mass @ a_plus)

    return Memory.none(inputs.axes), gains


@delay_method
def inverse(inputs: MethodInputs, longest: int, _: Settings) -> DelayFilter:
    """f_r[k] = -M_e a_g(t + tau) + S (alpha_c r[k] - (alpha_c - 1) r[k-1]).

    The assumed actuator is G(z) = z / (alpha_c z - (alpha_c - 1)), whose output reduces the
    remaining difference by 1 / alpha_c in each step. The command is passed through its inverse
    (Chen & Ricles 2009, Eng. Struct. 31:2643-2655). G lags by alpha_c - 1 steps, therefore
    alpha_c = 1 + tau / dt. The command is that of the solved loop, see `restoring` of seft: with
    the acceleration itself the inverse would make the feedback of high frequencies 2 alpha_c - 1
    times as large. The ground motion needs no inverse, because it is known ahead.
    """
    n, share = inputs.axes, inputs.share
    signals = Signals(inputs, preview=longest, blocks=1)  # of r[k-1]

    def gains(delay: float) -> Floats:
        lead = delay / inputs.dt
        r, before = signals.restoring_force, signals.state(0)
        ground = inputs.mass @ signals.ground_motion(delay)
        return np.asarray(-ground + share @ (r + lead * (r - before)))

    measured = np.hstack([np.zeros((n, 2 * n)), -inputs.mass, np.eye(n), np.zeros((n, n))])
    return Memory.past(measured, 1), gains


@delay_method
def smith(inputs: MethodInputs, longest: int, _: Settings) -> DelayFilter:
    """f_r(t) = -M_e a_g(t + tau) + S (r_s(t) + r(t) - r_s(t - tau)).

    Smith (1959, ISA J. 6:2, 28-33): the feedback is the response of a model of the specimen to the
    reference force without delay, corrected by the measured response minus that of the delayed
    model. If the model is right, the delay is outside the loop.

    The loop without delay is algebraic, M_e a_s + r_s = f_r and f_r = -(M_e + M_c) a_g - M_c a_s,
    and solved as in `restoring`; for the same reason the correction is that of the restoring force
    r = f - M_e a. The model's restoring force is r_s = C v_s + K x_s, with x_s and v_s exact for a
    force that varies linearly from step to step.
    """
    n, share = inputs.axes, inputs.share
    signals = Signals(inputs, preview=longest, blocks=2 + longest)
    free, before, at = _smith_model(inputs)
    stiffness_damping = np.hstack([inputs.stiffness, inputs.damping])
    # the model at this step is (states) + at f_r; then its past restoring forces, the newest first
    known = stiffness_damping @ np.vstack([signals.state(0), signals.state(1)])
    direct = stiffness_damping @ at

    def gains(delay: float) -> Floats:
        weights = between_samples(delay / inputs.dt, 1 + longest)
        delayed = sum(w * signals.state(2 + i) for i, w in enumerate(weights[1:]))
        now = 1 - weights[0]
        ground = inputs.mass @ signals.ground_motion(delay)
        force = -ground + share @ (now * known + signals.restoring_force - delayed)
        return np.linalg.solve(np.eye(n) - now * share @ direct, force)

    size = (2 + longest) * n
    a = np.eye(size, k=-n)
    a[: 2 * n] = 0.0
    a[: 2 * n, : 2 * n] = free
    a[2 * n : 3 * n] = known[:, :size]
    w = np.vstack([free @ at + before, direct, np.zeros((size - 3 * n, n))])
    return Memory(a, np.zeros((size, 4 * n)), np.zeros((size, n)), w), gains


def _smith_model(inputs: MethodInputs) -> tuple[Floats, Floats, Floats]:
    """Transition of (x_s, v_s) over a step: free z + before f_r[k] + at f_r[k+1].

    Raises
    ------
    InputError
        If the specimen does not come to rest by itself.
    """
    n, by_force = inputs.axes, np.linalg.inv(inputs.mass)
    none, one = np.zeros((n, n)), np.eye(n)
    specimen = by_force @ np.hstack([-inputs.stiffness, -inputs.damping])
    system = np.vstack([np.hstack([none, one]), specimen])
    free, held, slope = first_order_hold(system, np.vstack([none, by_force]), inputs.dt)
    if np.abs(np.linalg.eigvals(free)).max() > _AT_REST:
        raise InputError(
            "reference_force: compensation.method smith needs a model that comes to rest by "
            "itself; give specimen.damping and specimen.stiffness above zero on every axis"
        )
    return free, held - slope, slope
