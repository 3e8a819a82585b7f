"""Compensation methods by their name in a parameter file: ours, and those of other packages.

Each is one equation for the reference force f_r, with the delay tau that it compensates, the
measured restoring force r = f - M_e a, and S = M_c (M_e + M_c)^-1. Equation numbers are those of
the paper and of docs/theory.md.

With a computed substructure of more than lumped mass, whose dampers, springs and internal degrees
of freedom push the axes by the force g, the whole structure obeys

    (M_e + M_c) (a + a_g) + g = -r,   so   (M_e + M_c) (a + a_g + (M_e + M_c)^-1 g) = -r

In addition to its masses M_c on the axes a substructure acts like further ground acceleration. A
method receives a_g* = a_g + (M_e + M_c)^-1 g instead of a_g (docs/theory.md, More than lumped
mass).
"""

import math
from functools import partial
from itertools import pairwise

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_plant_sim.lti import first_order_hold

from seft_ros.reference_force import compensator
from seft_ros.reference_force.compensator import Compensator, LinearFilter, MethodInputs
from seft_ros.reference_force.reference_force_parameters import OWN_METHODS, REGISTERED_METHODS
from seft_ros.reference_force.target_motion import TargetMotion

_FINE = 0.2  # rad: phase of the fastest mode in a step; its frequency errs by a 24th of the square


def none(inputs: MethodInputs) -> Compensator:
    """f_r = -(M_e + M_c) a_g - M_c a (Eq. 2.5 and 5.3), with the measured acceleration."""
    n = inputs.axes
    measured = np.zeros((n, 4 * n))
    measured[:, 2 * n : 3 * n] = -inputs.computed_mass
    return compensator.LinearCompensator(LinearFilter.of_gains(measured, -inputs.total_mass))


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
    return compensator.LinearCompensator(LinearFilter.of_gains(measured, -inputs.mass))


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
    return compensator.LinearCompensator(LinearFilter.of_gains(measured, ground))


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
    is_whole = isinstance(made, Compensator)
    own = partial(make, inputs)
    return made if is_whole else compensator.RegisteredCompensator(name, own, inputs.axes)


_OTHERS = (name for name in REGISTERED_METHODS.names if name in REGISTERED_METHODS)
COMPENSATION_METHODS: dict[str, compensator.Method] = {
    **dict(zip(OWN_METHODS, (none, model, restoring, TargetMotion), strict=True)),
    **{name: partial(_registered, name) for name in _OTHERS},
}


REMAINDER_CORNER = 30.0  # Hz up to which the model's restoring force follows the measured one


def with_substructure(method: Compensator, inputs: MethodInputs) -> Compensator:
    """Make a method work with the whole computed substructure, see the module.

    Parameters
    ----------
    method : Compensator
        Made for the lumped masses.
    inputs : MethodInputs
        Its data.

    Returns
    -------
    Compensator
        The method itself if the substructure has masses only.
    """
    if inputs.computed.is_lumped:
        return method
    motion = substructure_motion(inputs, method.preview)
    if isinstance(method, compensator.LinearCompensator):
        return compensator.LinearCompensator(_behind(method.linear(), motion))
    return _BehindMotion(method, motion)


def substructure_motion(inputs: MethodInputs, preview: int) -> LinearFilter:
    """Give the filter whose output is the equivalent ground acceleration of a substructure.

    Its internal degrees of freedom are driven by the measured motion of the axes, exactly for a
    motion that is linear between samples: stable at any frequency and step. Over the preview, the
    whole structure moves as its model, with the measured restoring force.

    Parameters
    ----------
    inputs : MethodInputs
        With the substructure.
    preview : int
        Number of later steps whose ground motion is needed.

    Returns
    -------
    LinearFilter
        Its output is a_g + (M_e + M_c)^-1 g of this step and the later ones, shape
        ((1 + preview) n,), m/s^2.
    """
    n, computed, dt = inputs.axes, inputs.computed, inputs.dt
    inside, steps = 2 * computed.internal, 1 + preview
    # all signals are combinations of states, measured signals and ground motion
    every, places = np.eye(inside + n + 4 * n + steps * n), inside + n * np.arange(0, 5 + steps)
    before, remainder, x, v, a, f, *ground = np.split(every, places)
    system, by_ground = _internal(inputs)
    # the motion of the axes is an input
    driven = np.hstack([system[:, : 2 * n], by_ground])
    free, start, change = first_order_hold(system[:, 2 * n :], driven, dt)
    here = np.vstack([x, v, ground[0]])
    internal = before + change @ here
    going_on = free @ internal + (start - change) @ here
    residual = f - inputs.mass @ a - inputs.stiffness @ x - inputs.damping @ v
    share = 1.0 - np.exp(-2 * np.pi * REMAINDER_CORNER * dt)
    remainder = remainder + share * (residual - remainder)

    inverse = np.linalg.inv(inputs.total_mass)
    acceleration = inverse @ _force(inputs)
    # the whole structure: (x, v) of the axes and (z, z'), by ground acceleration and remainder
    elastic = -inverse @ np.hstack([inputs.stiffness, inputs.damping])
    moved = np.pad(elastic, [(0, 0), (0, inside)]) - acceleration
    whole = np.vstack([np.eye(n, 2 * n + inside, k=n), moved, system])
    none, apart = np.zeros((n, n)), np.zeros((inside, n))
    input_matrix = np.block([[none, none], [-np.eye(n), -inverse], [by_ground, apart]])
    free, start, change = first_order_hold(whole, input_matrix, dt)
    motion = np.vstack([x, v, internal])
    found = [ground[0] + acceleration @ motion]
    for now, later in pairwise(ground):
        rise = change @ np.vstack([later - now, np.zeros_like(remainder)])
        motion = free @ motion + start @ np.vstack([now, remainder]) + rise
        found.append(later + acceleration @ motion)
    states, signals = inside + n, inside + 5 * n
    c, d, e = np.split(np.vstack(found), [states, signals], axis=1)
    a, b, h = np.split(np.vstack([going_on, remainder]), [states, signals], axis=1)
    return LinearFilter(a, b, h, c, d, e)


class _BehindMotion:
    """A nonlinear method that receives the output of a `substructure_motion` as ground motion."""

    def __init__(self, method: Compensator, motion: LinearFilter) -> None:
        self.preview = method.preview
        self.estimates = method.estimates
        self._method, self._motion = method, motion
        self._matrix = np.ascontiguousarray(motion.matrix())
        self._work = np.zeros(self._matrix.shape[1])
        self._states, signals = np.split(self._work, [len(motion.a)])
        self._measured, self._ground = np.split(signals, [motion.d.shape[1]])

    def reset(self) -> None:
        """Forget the test so far."""
        self._work[:] = 0.0
        self._method.reset()

    def step(self, ground_motion: Floats, state: Floats) -> Floats:
        """Compute the reference force of one step, see `Compensator.step`."""
        self._measured[:] = state.reshape(-1)
        self._ground[:] = ground_motion.reshape(-1)
        result = self._matrix.dot(self._work)
        equivalent, self._states[:] = np.split(result, [len(self._motion.c)])
        return self._method.step(equivalent.reshape(ground_motion.shape), state)

    def linear(self) -> LinearFilter:
        """Linear filter of the method, see `Compensator.linear`."""
        return _behind(self._method.linear(), self._motion)


def _behind(method: LinearFilter, motion: LinearFilter) -> LinearFilter:
    """Put a filter behind one whose output is its ground motion."""
    none = np.zeros((len(motion.a), len(method.a)))
    return LinearFilter(
        a=np.block([[motion.a, none], [method.h @ motion.c, method.a]]),
        b=np.vstack([motion.b, method.b + method.h @ motion.d]),
        h=np.vstack([motion.h, method.h @ motion.e]),
        c=np.hstack([method.e @ motion.c, method.c]),
        d=method.d + method.e @ motion.d,
        e=method.e @ motion.e,
    )


def _force(inputs: MethodInputs) -> Floats:
    """Gain from (x, v, z, z') to the force g, shape (n, 2n + 2q)."""
    n, computed = inputs.axes, inputs.computed
    k, c = computed.stiffness, computed.damping
    return np.hstack([k[:n, :n], c[:n, :n], k[:n, n:], c[:n, n:]])


def _internal(inputs: MethodInputs) -> tuple[Floats, Floats]:
    """Rate of (z, z') from (x, v, z, z') and from a_g, shapes (2q, 2n + 2q) and (2q, n)."""
    n, computed, q = inputs.axes, inputs.computed, inputs.computed.internal
    mass = computed.mass[n:, n:]
    k, c = (np.linalg.solve(mass, one[n:]) for one in (computed.stiffness, computed.damping))
    moved = -np.hstack([k[:, :n], c[:, :n], k[:, n:], c[:, n:]])
    still = np.hstack([np.zeros((q, 2 * n + q)), np.eye(q)])
    return np.vstack([still, moved]), np.vstack([np.zeros((q, n)), -computed.influence])
