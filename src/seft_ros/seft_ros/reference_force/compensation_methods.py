"""Compensation methods by their name in a parameter file: ours, and those of other packages.

Each is one equation for the reference force f_r, with the delay tau that it compensates, the
measured restoring force r = f - M_e a, and S = M_c (M_e + M_c)^-1. Equation numbers are those of
the paper and of docs/theory.md.
"""

import math
from functools import partial

import numpy as np
from seft_msgs_py.arrays import Floats

from seft_ros.reference_force.compensator import (
    Compensator,
    Method,
    MethodInputs,
    RegisteredCompensator,
)
from seft_ros.reference_force.linear_filter import LinearCompensator, LinearFilter
from seft_ros.reference_force.reference_force_parameters import OWN_METHODS, REGISTERED_METHODS
from seft_ros.reference_force.target_motion import TargetMotion

_FINE = 0.2  # rad: phase of the fastest mode in a step; its frequency errs by a 24th of the square


def none(inputs: MethodInputs) -> Compensator:
    """f_r = -(M_e + M_c) a_g - M_c a (Eq. 2.5 and 5.3), with the measured acceleration."""
    n = inputs.axes
    measured = np.zeros((n, 4 * n))
    measured[:, 2 * n : 3 * n] = -inputs.computed_mass
    return LinearCompensator(LinearFilter.of_gains(measured, -inputs.total_mass))


def restoring(inputs: MethodInputs) -> Compensator:
    """f_r* = -M_e a_g + S r: the algebraic loop of the acceleration feedback, solved.

    The acceleration that the force will cause is eliminated from Eq. 2.5 by M_e a + r = f_r. With
    an ideal actuator the force is the same, but the feedback passes through the specimen's
    stiffness and damping instead of its mass, so that the loop gain falls with frequency and stays
    below one. The method needs no model except the mass.
    """
    n, share = inputs.axes, inputs.share
    measured = np.zeros((n, 4 * n))
    measured[:, 2 * n : 3 * n] = -share @ inputs.mass
    measured[:, 3 * n :] = share
    return LinearCompensator(LinearFilter.of_gains(measured, -inputs.mass))


def model(inputs: MethodInputs) -> Compensator:
    """f_r(t) = -(M_e + M_c) a_g(t + tau) - M_c a+, with a+ the acceleration predicted for t + tau.

    Model-based compensation (Carrion & Spencer 2007, NSEL report 6; section 6 of the paper): the
    measured displacement and velocity are the initial conditions of ::

        (M_e + M_c) a + C v + K x = -(M_e + M_c) a_g

    The central-difference method solves it up to t + tau under the known future ground motion, in
    equal steps of at most a sampling period that are short for the fastest mode.
    """
    n, delay, dt = inputs.axes, inputs.delay, inputs.dt
    mass, damping, stiffness = inputs.total_mass, inputs.damping, inputs.stiffness
    steps = whole_steps(delay, dt)  # of preview

    def load(time: float) -> Floats:
        weights = between_samples(time / dt, 1 + steps)
        return np.asarray(-mass @ np.hstack([np.zeros((n, 4 * n)), np.kron(weights, np.eye(n))]))

    squares = np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real
    count = max(steps, math.ceil(math.sqrt(squares.max(initial=0.0)) * delay / _FINE))
    h = delay / count
    # all motions are gains over the columns (x, v, a, f, ground accelerations)
    x, v = np.eye(n, (5 + steps) * n), np.eye(n, (5 + steps) * n, k=n)
    a = np.linalg.solve(mass, load(0.0) - damping @ v - stiffness @ x)
    last = x - h * v + h**2 / 2 * a
    effective = mass / h**2 + damping / (2 * h)
    for i in range(count + 1):  # one step beyond, for the acceleration at t + tau
        known = stiffness @ x - mass / h**2 @ (2 * x - last) - damping / (2 * h) @ last
        oldest, last, x = last, x, np.linalg.solve(effective, load(i * h) - known)
    a = (x - 2 * last + oldest) / h**2
    measured, ground = np.split(load(delay) - inputs.computed_mass @ a, [4 * n], axis=1)
    return LinearCompensator(LinearFilter.of_gains(measured, ground))


_ROUNDING = 1e-9  # of a sampling period


def whole_steps(time: float, dt: float) -> int:
    """Fewest whole steps that cover a time, at least one."""
    return max(1, math.ceil(time / dt - _ROUNDING))


def between_samples(steps: float, count: int) -> Floats:
    """Weights of ``count`` samples for the value ``steps`` after the first: linear interpolation.

    Returns
    -------
    ndarray
        Shape (count,); after the last sample they give the last value.
    """
    weights: Floats = np.maximum(0.0, 1.0 - np.abs(np.arange(count) - min(steps, count - 1.0)))
    return weights


def _registered(name: str, inputs: MethodInputs) -> Compensator:
    settings = inputs.options.get("compensation.settings", "")
    make = partial(REGISTERED_METHODS.make, name, settings, "reference_force: compensation.method")
    made = make(inputs)
    if isinstance(made, Compensator):
        return made
    return RegisteredCompensator(name, partial(make, inputs), inputs.axes)


COMPENSATION_METHODS: dict[str, Method] = {
    **dict(zip(OWN_METHODS, (none, model, restoring, TargetMotion), strict=True)),
    **{
        name: partial(_registered, name)
        for name in REGISTERED_METHODS.names
        if name in REGISTERED_METHODS
    },
}
