"""What `target_motion` and `velocity_feedforward` do while their estimates stay: linear systems.

Nothing is written down a second time: the compiled steps themselves are applied to each unit vector
of their states and inputs. Their parameters are such that they learn nothing and meet no limit; a
loaded valve is left out, which is of second order in the motion.
"""

import itertools
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from seft_ros.force_controller.force_control import LinearControl
from seft_ros.force_controller.velocity_feedforward import (
    LARGEST_DELAY_ERROR,
    LARGEST_GAIN_ERROR,
    VelocityFeedforward,
    begin_feedforward,
    feedforward_step,
)
from seft_ros.reference_force.linear_filter import LinearFilter
from seft_ros.target.target_motion import TargetMotion
from seft_ros.target.target_step import begin_target, target_step

Floats = npt.NDArray[np.float64]

CERTAIN = 1e30
"""Variance, or evidence, beside which all others are nothing."""
BOUNDS = list(
    itertools.product(
        (-LARGEST_GAIN_ERROR, LARGEST_GAIN_ERROR), (-LARGEST_DELAY_ERROR, LARGEST_DELAY_ERROR)
    )
)
"""Errors of a valve that are as large as the controller may take them for."""


def frozen_target(method: TargetMotion, measured: bool) -> LinearFilter:
    """Linear filter from what is measured to all of the target's points; the method begins anew.

    The output has the shape ((1 + preview) 3 n,). ``measured``: the restoring force is the
    measured one, as after a change of the specimen: r* = r + K (x* - x) + C (v* - v). Else it is
    K x* + C v*, as a test starts.
    """
    state, model = method.state, method.parameters.model
    nothing = np.zeros_like(model.prior)
    model = model._replace(prior=nothing, drift=nothing, change=nothing, surprise=np.inf)
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
        if measured:  # the offset follows at once, and nothing speaks for what is told
            state.model.covariance[:, 0, 0] = CERTAIN
            state.model.sums[:, 4] = -CERTAIN

    def step() -> None:
        target_step(parameters, state, ground, y, 1.0, points)

    (c, d, e), (a, b, h) = _system(begin, step, states, [y, ground], points)
    method.reset()
    return LinearFilter(a, b, h, c, d, e)


def frozen_feedforward(
    control: VelocityFeedforward, errors: tuple[float, float] = (0.0, 0.0)
) -> LinearControl:
    """Linear controller from points and what is measured to the valves; begins anew.

    In place of the reference force its input holds the points that it reads. ``errors`` are what
    it takes for those of each valve: of the flow gain, relative, and of the delay, s.
    """
    parameters, state = control.parameters, control.state
    actuator = parameters.actuator.copy()
    actuator[:, 3] = np.inf
    parameters = parameters._replace(limit=np.inf, actuator=actuator)
    n = len(actuator)
    y, command = np.zeros((4, n)), np.zeros(n)
    points = np.zeros((1 + parameters.inverse.shape[1], 3, n))

    def begin() -> None:
        begin_feedforward(parameters, state)
        state.errors[:] = errors
        state.covariance[:] = 0.0
        state.steps[0] = 1.0

    def step() -> None:
        feedforward_step(parameters, state, points, y, command)

    states = [state.measured, state.sent, state.flows]
    (c, *d), (a, *b) = _system(begin, step, states, [points, y], command)
    control.reset()
    return LinearControl(a, np.hstack(b), c, np.hstack(d))


def read_of_points(control: LinearControl) -> tuple[Floats, LinearControl]:
    """Part a controller of points: the q values that it makes of them, and what it makes of those.

    Returns a matrix of shape (q, points), with few rows, and a controller of these values.
    """
    axes = len(control.d)
    known = control.d.shape[1] - 4 * axes
    by_points = np.vstack([control.d[:, :known], control.b[:, :known]])
    used = np.flatnonzero(by_points.any(axis=1))
    handed_on = np.eye(len(by_points))[:, used]
    d = np.hstack([handed_on[:axes], control.d[:, known:]])
    b = np.hstack([handed_on[axes:], control.b[:, known:]])
    return by_points[used], LinearControl(control.a, b, control.c, d)


def _system(
    begin: Callable[[], None],
    step: Callable[[], None],
    states: Sequence[Floats],
    inputs: Sequence[Floats],
    output: Floats,
) -> tuple[list[Floats], list[Floats]]:
    """Find the matrices of a linear step, which ``begin`` makes ready and ``step`` runs in place.

    It reads states and inputs, and writes the output and the next states. Returned are, of the
    outputs and of the next states, the parts by the states, then by each of the inputs.
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
    parts = np.split(np.array(columns).T, np.cumsum(sizes)[:-1], axis=1)
    rows = [np.split(part, [output.size]) for part in parts]
    return [first for first, _ in rows], [second for _, second in rows]
