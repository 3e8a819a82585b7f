"""The sampled closed loop of a test, exact: rig, compensation and force control."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.linalg import eig
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from seft_msgs_py.arrays import Complexes, Floats
from seft_plant_sim.judge.valve_following import LARGEST_DELAY_ERROR, LARGEST_GAIN_ERROR

from seft_ros.force_controller.force_control import LinearControl
from seft_ros.force_controller.velocity_feedforward import (
    VelocityFeedforward,
    feedforward_step,
)
from seft_ros.reference_force.compensator import LinearFilter
from seft_ros.reference_force.target_motion import TargetMotion
from seft_ros.reference_force.target_step import begin_target, target_step

LARGE = 60
"""Number of states from which on it pays to split a loop."""


@dataclass(frozen=True)
class SampledLoop:
    """States q of a whole test over n axes: q[k+1] = matrix q[k] + ground g[k...], x = c q.

    Attributes
    ----------
    matrix : ndarray
        Shape (N, N).
    ground : ndarray
        Shape (N, (1 + preview) n), from the ground accelerations of this and the next steps.
    displacement : ndarray
        c, shape (n, N).
    """

    matrix: Floats
    ground: Floats
    displacement: Floats

    def eigenvalues(self) -> Complexes:
        """All N eigenvalues z; the test is stable where every |z| < 1.

        A large loop is first split into its strongly connected parts: they have the same
        eigenvalues and cost less.
        """
        if len(self.matrix) < LARGE:
            return np.linalg.eigvals(self.matrix).astype(np.complex128)
        _, block = connected_components(csr_array(self.matrix), connection="strong")
        sizes = np.bincount(block)
        found = [np.diag(self.matrix)[sizes[block] == 1]]
        for index in np.flatnonzero(sizes > 1):
            part = np.flatnonzero(block == index)
            found.append(np.linalg.eigvals(self.matrix[np.ix_(part, part)]))
        return np.concatenate(found).astype(np.complex128)

    def dominant(self) -> complex:
        """Eigenvalue of the largest magnitude, of a pair the upper."""
        found = self.eigenvalues()
        z = complex(found[np.abs(found).argmax()])
        return complex(z.real, abs(z.imag))

    def modes(self) -> tuple[Complexes, Complexes]:
        """Eigenvalues z, shape (N,), and their residues, shape (N, n, n).

        The residues are those of the transfer function from ground acceleration to displacement.
        """
        z, left, right = eig(self.matrix, left=True)
        n = len(self.displacement)
        known_ahead = self.ground.reshape(len(z), -1, n)
        powers = z[:, np.newaxis] ** np.arange(known_ahead.shape[1])
        entering = np.einsum("si,spn,ip->in", left.conj(), known_ahead, powers)
        scale = np.einsum("si,si->i", left.conj(), right)
        leaving = (self.displacement @ right).T
        with np.errstate(divide="ignore", invalid="ignore"):  # of delays, which are defective
            return z, leaving[:, :, np.newaxis] * (entering / scale[:, np.newaxis])[:, np.newaxis]


def closed_loop(
    rig: tuple[Floats, Floats, Floats], compensation: LinearFilter, control: LinearControl
) -> SampledLoop:
    """Close the loop as the blocks run it.

    The rig with states q (a, b, c of `LoopRig.sampled`) gives y = (x, v, a, f) = c q at sample k;
    the compensation gives p = c s + d y + e g, the reference force or other inputs of the
    controller, which makes the drive u of p and y; u acts on the rig from sample k+1 on. The
    states are those of the rig, the compensation and the controller.
    """
    a, b, c = rig
    size, axes = len(compensation.d), b.shape[1]
    # what p and y do to the rig, and to the states of the controller
    rig_by_p, rig_by_y = np.split(b @ control.d, [size], axis=1)
    control_by_p, control_by_y = np.split(control.b, [size], axis=1)
    p_by_rig = compensation.d @ c
    none = np.zeros((len(compensation.a), len(control.a)))
    matrix = np.block(
        [
            [a + rig_by_p @ p_by_rig + rig_by_y @ c, rig_by_p @ compensation.c, b @ control.c],
            [compensation.b @ c, compensation.a, none],
            [control_by_p @ p_by_rig + control_by_y @ c, control_by_p @ compensation.c, control.a],
        ]
    )
    ground = np.vstack([rig_by_p @ compensation.e, compensation.h, control_by_p @ compensation.e])
    displacement = np.pad(c[:axes], ((0, 0), (0, len(matrix) - len(b))))
    return SampledLoop(matrix, ground, displacement)


CERTAIN = 1e30
"""Variance, or evidence, beside which all others are negligible."""
_BOUNDS = itertools.product(
    (-LARGEST_GAIN_ERROR, LARGEST_GAIN_ERROR), (-LARGEST_DELAY_ERROR, LARGEST_DELAY_ERROR)
)
_ERRORS = ((0.0, 0.0), *_BOUNDS)  # of a valve, that a controller assumes: at the start, at most


def frozen_target(method: TargetMotion, measured: bool) -> LinearFilter:
    """Linear filter from the measured state to all points of the target; the method is reset.

    The output has the shape ((1 + preview) 3 n,). ``measured``: the restoring force is the
    measured one, as after a change of the specimen: r* = r + K (x* - x) + C (v* - v). Else it is
    K x* + C v*, as at the start of a test. The parameters are such that the method adapts nothing.
    """
    state, model = method.state, method.parameters.model
    nothing = np.zeros_like(model.prior)
    model = model._replace(prior=nothing, drift=nothing, change=nothing, surprise=np.inf)
    model = model._replace(stuck=np.zeros_like(model.stuck))
    parameters = method.parameters._replace(model=model)
    n = len(parameters.mass)
    y, points = np.zeros((4, n)), np.zeros((1 + method.preview, 3, n))
    ground = np.zeros((1 + method.preview, n))
    motion = state.target[: 2 * len(parameters.influence)]  # the push on it is made anew
    states = [state.measured, motion, state.ground]
    if measured:
        states.append(state.constant[1])  # the push of the offset, which the next step starts from

    def begin() -> None:
        begin_target(parameters, state)
        state.is_running[0] = 1.0
        if measured:  # the offset follows at once; the assumed stiffness has no weight
            state.model.covariance[:, 0, 0] = CERTAIN
            state.model.sums[:, 4] = -CERTAIN

    step = partial(target_step, parameters, state, ground, y, 1.0, points)
    (c, d, e), (a, b, h) = _system(begin, step, states, [y, ground], points)
    method.reset()
    return LinearFilter(a, b, h, c, d, e)


def frozen_feedforward(control: VelocityFeedforward) -> list[tuple[Floats, LinearControl]]:
    """Linear controllers from points and measured state to the valves; the controller is reset.

    As it starts, then with the errors of the valves (of the flow gain and of the delay) at the
    bounds to which it may adapt them. The pressure drop under load is left out: it is of second
    order in the motion.

    Each is a matrix of few rows, (q, points), and a controller that reads its q products with the
    points in place of the reference force: they are all that it needs of the points.
    """
    parameters, state = control.parameters, control.state
    actuator = parameters.actuator.copy()
    actuator[:, 3] = np.inf
    parameters = parameters._replace(limit=np.inf, actuator=actuator)
    n = len(actuator)
    y, command = np.zeros((4, n)), np.zeros(n)
    points = np.zeros((2 + state.coming.shape[1], 3, n))

    def begin(errors: tuple[float, float]) -> None:
        control.reset()
        state.errors[:, : len(errors)] = errors  # an error of the oil changes the plan alone
        state.covariance[:] = 0.0
        state.steps[0] = 1.0

    step = partial(feedforward_step, parameters, state, points, y, command)
    states, found = [state.measured, state.sent, state.flows], []
    for errors in _ERRORS:
        outputs, next_states = _system(partial(begin, errors), step, states, [points, y], command)
        (c, d_points, d_state), (a, b_points, b_state) = outputs, next_states
        by_points = np.vstack([d_points, b_points])
        used = np.flatnonzero(by_points.any(axis=1))
        handed_on = np.eye(len(by_points))[:, used]
        d, b = np.hstack([handed_on[:n], d_state]), np.hstack([handed_on[n:], b_state])
        found.append((by_points[used], LinearControl(a, b, c, d)))
    control.reset()
    return found


def _system(
    begin: Callable[[], None],
    step: Callable[[], object],
    states: Sequence[Floats],
    inputs: Sequence[Floats],
    output: Floats,
) -> tuple[list[Floats], list[Floats]]:
    """Find the matrices of a linear step, which ``begin`` prepares and ``step`` runs in place.

    The compiled step is applied to each unit vector of states and inputs; it writes the output
    and the next states. Returned are the matrices of the outputs, then those of the next states:
    by the states, then by each input.
    """
    columns = []
    for array in (*states, *inputs):
        for place in np.ndindex(array.shape):
            begin()
            for other in (*states, *inputs):
                other[...] = 0.0
            array[place] = 1.0
            step()
            columns.append(np.concatenate([part.ravel() for part in (output, *states)]))
    sizes = [sum(part.size for part in states), *(part.size for part in inputs)]
    outputs, next_states = np.split(np.array(columns).T, [output.size])
    ends = np.cumsum(sizes)[:-1]
    return np.split(outputs, ends, axis=1), np.split(next_states, ends, axis=1)
