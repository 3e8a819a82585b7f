"""The whole structure's motion under the measured restoring force, and its prediction.

With the force r of the specimen at the target (x*, v*), the computed part's springs and dampers in
C_c and K_c, and L the ground acceleration of each degree of freedom::

    (M_e + M_c) (a* + L a_g) + C_c v* + K_c x* + r(x*, v*) = 0                             (1)

The assumed elastic specimen and the computed part are integrated exactly. The
difference of r from the assumed specimen, the push, acts like the ground motion, and is linear
between samples (ETD2RK, Cox & Matthews 2002, Eq. 22).
"""

from typing import Annotated, NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats, Ints, Record
from seft_plant_sim.compiled import compiled, copy, is_finite, multiply_sized

from seft_ros.reference_force.observers import observe
from seft_ros.reference_force.restoring_model import (
    CORNER,
    LINE,
    THRESHOLDS,
    ModelParameters,
    RestoringState,
    begin_model,
    follow_specimen,
    move_stops,
    slide_on,
    slider_forces,
)

ESTIMATE_NAMES = ("stiffness", "damping", "friction")
"""Rows of `target_estimates`."""
POSITION_ROW, SPEED_ROW, FORCE_ROW = range(3)
"""Rows of a point: displacement (m), velocity (m/s) and actuator force (N) of the target."""


class TargetParameters(NamedTuple):
    """Parameters of a target of n axes, with N degrees of freedom in all.

    Attributes
    ----------
    axes, dofs : tuple of int or ndarray
        0 to n - 1, and 0 to N - 1, see `places`.
    dt : float
        Sampling period, s.
    substeps : int
        Steps of the integration in a period.
    gains : ndarray
        Of the observer, shape (n, 2, 2).
    by_force, stepping : ndarray
        M_e^-1, shape (n, n), 1/kg, and `steps_of_force`, shape (2,).
    smooth : ndarray
        Weights that smooth the channels where the acceleration is derived, see
        `second_difference`, shape (3, w); w is 0 if it is measured.
    mass : ndarray
        M_e on the rig, shape (n, n), kg.
    deformation, to_springs : ndarray
        D, and D^-T from forces of the axes to forces of the springs; shape (n, n).
    hold, change : ndarray
        Integration over a substep, see `first_order_hold`: shapes (2N, 3N) and (2N, N). The states
        are displacements, then velocities; the input, an acceleration, follows them.
    deforming : ndarray
        Change of the springs' deformations in a substep from these; shape (n, 3N).
    steady, force : ndarray
        G of `predict` for a constant push, and F without stiffness, damping and offset of the
        springs; transposed, shapes (s, 3N + n) and (s, n), s = 3N + 2n + 1.
    influence, by_spring : ndarray
        Accelerations per ground acceleration, and per force of each spring: shape (N, n).
    by_assumed : ndarray
        Accelerations by the assumed specimen, per displacement and velocity, shape (N, 2n).
    damper : float
        Rate at which the target's motion decays in a ramp-down, 1/s.
    model : ModelParameters
        Of the restoring force.
    """

    axes: tuple[int, ...] | Ints
    dofs: tuple[int, ...] | Ints
    dt: float
    substeps: int
    gains: Floats
    by_force: Floats
    stepping: Floats
    smooth: Floats
    mass: Floats
    deformation: Floats
    to_springs: Floats
    hold: Floats
    change: Floats
    deforming: Floats
    steady: Floats
    force: Floats
    influence: Floats
    by_spring: Floats
    by_assumed: Floats
    damper: float
    model: ModelParameters


class TargetState(NamedTuple):
    """State of a target: arrays of zeros before `begin_target`, but for constants of `predict`."""

    model: RestoringState
    recent: Annotated[Floats, "w", 2, "n"]  # last displacements and forces, the newest first
    smoothed: Annotated[Floats, 4, "n"]  # the smoothed sample
    before: Annotated[Floats, "late", "n"]  # ground accelerations of the steps since that
    known: Annotated[Floats, "ahead", "n"]  # room for those and the coming ones
    ahead: Annotated[Floats, "ahead", 3, "n"]  # room for the points from there on
    measured: Annotated[Floats, 3, "n"]  # observed displacement, velocity; last acceleration
    force_before: Annotated[Floats, "n"]  # the last force
    target: Annotated[Floats, "3N"]  # displacements and velocities of the target, and the push
    stops: Annotated[Floats, "n", THRESHOLDS]  # its stop operators
    future_stops: Annotated[Floats, "n", THRESHOLDS]  # those of its prediction
    sliding: Annotated[Record, LINE, "n"]
    ground: Annotated[Floats, "n"]  # last ground acceleration
    by_motion: Annotated[Floats, "n", "2n"]  # force of each spring per displacement and velocity
    by_state: Annotated[Floats, 2, "N", "2N"]  # push of the model at the last sample and at this
    # one: accelerations per state
    constant: Annotated[Floats, 2, "N"]  # its constant part
    line: Floats  # push of a computed model, see `ModelLine.values`; (N, 2N + 2), or (0, 2N + 2)
    rise: Floats  # change of the push in a substep from z of `predict`, (N, s)
    correction: Floats  # its effect on the result, transposed, (N, 3N + n)
    substep: Annotated[Floats, "s", "3N + n"]  # G of `predict`, transposed
    force: Floats  # F of it, likewise, (s, n)
    future: Annotated[Floats, "s"]  # z of `predict`
    next: Annotated[Floats, "3N + n"]  # G z
    is_running: Annotated[Floats, 1]  # whether a sample has been taken
    axes: Annotated[Floats, 3, "n"]  # room
    dofs: Annotated[Floats, 3, "2N"]
    springs: Annotated[Floats, 7, "n"]


@compiled
def begin_target(parameters: TargetParameters, state: TargetState) -> None:
    """Begin a test: the target will start at the specimen's position."""
    begin_model(parameters.model, state.model)
    state.before[:] = 0.0
    state.target[:] = 0.0
    state.stops[:] = 0.0
    state.is_running[0] = 0.0
    state.future[3 * len(parameters.dofs) + len(parameters.axes)] = 1.0
    take_model(parameters, state, 1.0)


@compiled
def target_step(
    parameters: TargetParameters,
    state: TargetState,
    ground: Floats,
    measured: Floats,
    progress: float,
    points: Floats,
) -> None:
    """Update the target with a sample, and predict it, see `update_target`.

    What is smoothed shows the specimen some steps ago. So the target is updated by the ground
    motion of that step, and predicted from there.
    """
    past, count = len(state.before), len(points)
    if past == 0 or not is_finite(measured, 0):
        update_target(parameters, state, ground, measured, progress, points)
        return
    smooth_alike(parameters.smooth, state, measured, state.is_running[0] == 0.0)
    known, ahead = state.known[: past + count], state.ahead[: past + count]
    for i in range(ground.shape[1]):
        for j in range(past):
            known[j, i] = state.before[j, i]
            state.before[j, i] = state.before[j + 1, i] if j + 1 < past else ground[0, i]
        for j in range(count):
            known[past + j, i] = ground[j, i]
    update_target(parameters, state, known, state.smoothed, progress, ahead)
    for j in range(count):
        for row in range(points.shape[1]):
            for i in range(points.shape[2]):
                points[j, row, i] = ahead[past + j, row, i]


@compiled
def update_target(
    parameters: TargetParameters,
    state: TargetState,
    ground: Floats,
    measured: Floats,
    progress: float,
    points: Floats,
) -> None:
    """Update the target with a sample, and predict it.

    Parameters
    ----------
    parameters, state
        The state is updated.
    ground : ndarray
        Ground acceleration of this step and the future ones, shape (h + 1, n), m/s^2.
    measured : ndarray
        Displacement, velocity, acceleration and force of the specimen, shape (4, n).
    progress : float
        1 in a test. While it falls to 0, the ground motion fades and the target slows down to rest.
    points : ndarray
        The target at this step and the future ones: displacement, velocity and force of each axis,
        shape (h + 1, 3, n). The result. If the sample is not finite, all are NaN, and the target
        is not updated, because its state would then remain not finite.
    """
    if not is_finite(measured, 0):
        points[:] = np.nan
        return
    n, p, first = len(parameters.axes), parameters, state.is_running[0] == 0.0
    before, e, rate, force = state.springs[0], state.springs[1], state.springs[2], state.springs[3]
    if not first:
        times(n, n, p.deformation, state.measured[0], before)
    if not first and p.stepping.any():
        _take_step_of_force(p, state, measured[3])
    copy(n, measured[3], state.force_before)
    observe(p.gains, p.dt, first, measured, state.measured)
    times(n, n, p.deformation, state.measured[0], e)
    times(n, n, p.deformation, state.measured[1], rate)
    # r = f - M_e a (2)
    times(n, n, p.mass, measured[2], state.axes[0])
    for i in range(n):
        state.axes[0, i] = measured[3, i] - state.axes[0, i]
    times(n, n, p.to_springs, state.axes[0], force)
    if first:  # at rest, at the specimen's position
        copy(n, state.measured[0], state.target)
        before[:] = 0.0
        move_stops(p.model, state.model.thresholds, e, state.stops)
    # by way of where it turned, if it did since the last sample, with a constant acceleration
    turn, moved = state.springs[4], state.springs[5]
    for i in range(n):
        was = state.model.last[i, 1 + n + i]
        turn[i] = 0.5 * p.dt * was * was / (was - rate[i]) if was * rate[i] < 0.0 else 0.0
        moved[i] = e[i] - before[i] - turn[i]
    move_stops(p.model, state.model.thresholds, turn, state.model.stops)
    move_stops(p.model, state.model.thresholds, moved, state.model.stops)
    follow_specimen(p.model, state.model, e, rate, force)
    for j in range(n):
        state.stops[j, CORNER] += state.model.corner.slider[j].shift
    take_model(p, state, progress)
    if not first:
        advance(p, state, state.ground, ground[0], progress)
    state.is_running[0] = 1.0
    copy(n, ground[0], state.ground)
    predict(p, state, ground, progress, points)


@compiled
def _take_step_of_force(p: TargetParameters, state: TargetState, force: Floats) -> None:
    """Add what a step of the force, shape (n,), makes of the motion until this sample."""
    n, step, rise = len(p.axes), state.axes[0], state.axes[1]
    for i in range(n):
        step[i] = force[i] - state.force_before[i]
    times(n, n, p.by_force, step, rise)
    beside = p.stepping[0] - p.dt * p.stepping[1]  # of what `observe` adds of v
    for i in range(n):
        state.measured[0, i] += beside * rise[i]
        state.measured[1, i] += p.stepping[1] * rise[i]


@compiled
def smooth_alike(weights: Floats, state: TargetState, measured: Floats, first: bool) -> None:
    """Smooth displacement and force alike, and derive velocity and acceleration."""
    recent, (_, count) = state.recent, weights.shape
    for j in range(count - 1, -1, -1):
        for i in range(measured.shape[1]):
            for k in range(2):
                now = first or j == 0
                recent[j, k, i] = measured[3 * k, i] if now else recent[j - 1, k, i]
    for i in range(measured.shape[1]):
        x = v = a = f = 0.0
        for j in range(count):
            x += weights[0, j] * recent[j, 0, i]
            v += weights[1, j] * recent[j, 0, i]
            a += weights[2, j] * recent[j, 0, i]
            f += weights[0, j] * recent[j, 1, i]
        sample = state.smoothed
        sample[0, i], sample[1, i], sample[2, i], sample[3, i] = x, v, a, f


@compiled
def target_estimates(parameters: TargetParameters, state: TargetState, result: Floats) -> None:
    """Give the identified stiffness, damping and sliders' force of each spring, shape (3, n)."""
    values, thresholds = state.model.found, parameters.model.thresholds
    n = len(parameters.axes)
    for j in range(n):
        result[0, j], result[1, j] = values[j, 1 + j], values[j, 1 + n + j]
        result[2, j] = 0.0
        for i in range(thresholds.shape[1]):
            result[2, j] += values[j, 1 + 2 * n + i] * thresholds[j, i]


@compiled
def times(rows: int, columns: int, matrix: Floats, vector: Floats, result: Floats) -> None:
    """Multiply a matrix by a vector."""
    for i in range(rows):
        total = 0.0
        for k in range(columns):
            total += matrix[i, k] * vector[k]
        result[i] = total


@compiled
def take_model(p: TargetParameters, state: TargetState, progress: float) -> None:
    """Make the push from the model's parameters; the former push becomes the last one."""
    n, half, values, by_motion = len(p.axes), len(p.dofs), state.model.values, state.by_motion
    for j in range(n):
        multiply_sized(n, n, p.deformation, values[j, 1:], by_motion[j])
        multiply_sized(n, n, p.deformation, values[j, 1 + n :], by_motion[j, n:])
    by_state, constant = state.by_state[1], state.constant[1]
    for i in range(half):
        state.constant[0, i], constant[i] = constant[i], 0.0
        for k in range(2 * half):
            state.by_state[0, i, k], by_state[i, k] = by_state[i, k], 0.0
        by_state[i, half + i] = -(1.0 - progress) * p.damper
        for k in range(n):
            by_state[i, k] += p.by_assumed[i, k]
            by_state[i, half + k] += p.by_assumed[i, n + k]
        for j in range(n):
            factor = p.by_spring[i, j]
            constant[i] -= factor * values[j, 0]
            for k in range(n):
                by_state[i, k] -= factor * by_motion[j, k]
                by_state[i, half + k] -= factor * by_motion[j, n + k]
    for i in range(len(state.line)):
        constant[i] += state.line[i, 2 * half]
        for k in range(2 * half):
            by_state[i, k] += state.line[i, k]


@compiled
def push(
    p: TargetParameters,
    state: TargetState,
    model: int,
    y: Floats,
    sliders: Floats,
    ground: Floats,
    result: Floats,
) -> None:
    """Find the push on the elastic whole structure, as N accelerations in the result.

    It consists of the ground motion (times the progress), and the difference of the specimen's
    force from the assumed elastic one, by the model of the last sample (0) or this one (1), with
    these forces of sliders.
    """
    by_state, constant = state.by_state[model], state.constant[model]
    for i in range(len(p.dofs)):
        total = constant[i]
        for k in range(2 * len(p.dofs)):
            total += by_state[i, k] * y[k]
        for k in range(len(p.axes)):
            total -= p.influence[i, k] * ground[k] + p.by_spring[i, k] * sliders[k]
        result[i] = total


@compiled
def specimen_force(
    p: TargetParameters, state: TargetState, y: Floats, sliders: Floats, r: Floats
) -> None:
    """Force of the specimen at the state y by this sample's model: r = D^T s, shape (n,), N."""
    n = len(p.axes)
    r[:] = 0.0
    for j in range(n):
        s = state.model.values[j, 0] + sliders[j]
        for k in range(2 * n):
            s += state.by_motion[j, k] * y[k]
        for i in range(n):
            r[i] += p.deformation[j, i] * s


@compiled
def advance(
    p: TargetParameters, state: TargetState, before: Floats, now: Floats, progress: float
) -> None:
    """Integrate Eq. (1) from the last sample to this one; the model changes linearly."""
    n, half, model, ground = len(p.axes), len(p.dofs), state.model, state.axes[1]
    y, begin, stops = state.target, state.target[2 * half :], state.stops
    old, new, moved = state.dofs[0], state.dofs[1], state.dofs[2]
    change, of_old, of_new = state.springs[4], state.springs[5], state.springs[6]
    for step in range(p.substeps):
        for side in range(2):
            slider_forces(p.model, model.before, stops, of_old)
            slider_forces(p.model, model.values, stops, of_new)
            part = (step + side) / p.substeps
            for i in range(n):
                ground[i] = progress * (before[i] + part * (now[i] - before[i]))
            push(p, state, 0, y, of_old, ground, old)
            push(p, state, 1, y, of_new, ground, new)
            for i in range(half):
                new[i] = old[i] + part * (new[i] - old[i])
                for j in range(n):  # the correction of the restoring force's past impulse
                    new[i] -= p.by_spring[i, j] * model.sums[j].correction
            for i in range(len(state.line)):
                new[i] += part * p.dt * state.line[i, 2 * half + 1]
            if side:  # correct the state by the change of the push
                for i in range(2 * half):
                    for k in range(half):
                        y[i] += p.change[i, k] * (new[k] - begin[k])
                continue
            copy(half, new, begin)
            times(n, 3 * half, p.deforming, y, change)
            move_stops(p.model, model.thresholds, change, stops)
            times(2 * half, 3 * half, p.hold, y, moved)
            copy(2 * half, moved, y)


@compiled
def take_substep(p: TargetParameters, state: TargetState) -> None:
    """Make the parts of G and F of `predict` that depend on this sample's model.

    With a constant push b over the substep, the push at its end would be c. The state is corrected
    by ``change (c - b)``, and with it the push: ``G z`` is the effect of a constant push, and
    `correction` that of the rise c - b.
    """
    n, half, by_state, by_motion = len(p.axes), len(p.dofs), state.by_state[1], state.by_motion
    rise, correction, substep, force = state.rise, state.correction, state.substep, state.force
    size, one = 3 * half, 3 * half + n
    for i in range(half):
        for k in range(size):
            rise[i, k] = -1.0 if k == 2 * half + i else 0.0
            for m in range(2 * half):
                rise[i, k] += by_state[i, m] * p.hold[m, k]
        rise[i, one] = state.constant[1, i]
        for m in range(half):
            total = 1.0 if m == i else 0.0
            for k in range(2 * half):
                total += by_state[m, k] * p.change[k, i]
            correction[i, 2 * half + m] = total
        times(n, size, p.deforming, correction[i], correction[i, size:])
    for k in range(size + 2 * n + 1):
        for m in range(size + n):
            total = p.steady[k, m]
            for i in range(half):
                total += rise[i, k] * correction[i, m]
            substep[k, m] = total
    for i in range(n):
        force[one, i] = 0.0
        for j in range(n):
            force[one, i] += p.deformation[j, i] * state.model.values[j, 0]
        for k in range(n):
            x, v = p.force[k, i], p.force[half + k, i]
            for j in range(n):
                x += p.deformation[j, i] * by_motion[j, k]
                v += p.deformation[j, i] * by_motion[j, n + k]
            force[k, i], force[half + k, i] = x, v


@compiled
def predict(
    p: TargetParameters, state: TargetState, known: Floats, progress: float, points: Floats
) -> None:
    """Integrate Eq. (1) over the future steps, and write the points, see `target_step`.

    The model does not change, so that all except the stops is linear in the state y, the push b,
    the ground acceleration a_g and the forces s of the sliders at the end of a substep. The force,
    f_r of Eq. 2.5 with a*, is linear in these, too::

        f* = M_e a* + r = F z,  z = (y, b, a_g, 1, s)                                          (3)
        (y, b, change of the deformations in the next substep) = G z
    """
    n, half, z, new = len(p.axes), len(p.dofs), state.future, state.next
    size, stops = 3 * half, state.future_stops
    columns = size + 2 * n + 1
    ground, sliders, change = z[size : size + n], z[size + n + 1 :], new[size:]
    take_substep(p, state)
    copy(2 * half, state.target, z)
    for j in range(n):
        ground[j] = progress * known[0, j]
        copy(THRESHOLDS, state.stops[j], stops[j])
        line = state.sliding[j]
        line.force = line.slope = line.moved = line.sense = 0.0
        line.room = -1.0
    slider_forces(p.model, state.model.values, stops, sliders)
    push(p, state, 1, z, sliders, ground, z[2 * half :])
    for i in range(len(state.line)):
        z[2 * half + i] += p.dt * state.line[i, 2 * half + 1]
    times(n, size, p.deforming, z, change)
    for point in range(len(points)):
        copy(n, z, points[point, 0])
        copy(n, z[half:], points[point, 1])
        multiply_sized(columns, n, state.force, z, points[point, 2])
        if point + 1 == len(points):
            break
        for step in range(p.substeps):
            part = (step + 1) / p.substeps
            for i in range(n):
                rise = known[point + 1, i] - known[point, i]
                ground[i] = progress * (known[point, i] + part * rise)
            slide_on(
                p.model,
                state.model.thresholds,
                state.model.values,
                change,
                stops,
                state.sliding,
                sliders,
            )
            multiply_sized(columns, size + n, state.substep, z, new)
            for i in range(len(state.line)):
                rise = (1.0 + point + part) * p.dt * state.line[i, 2 * half + 1]
                for k in range(size + n):
                    new[k] += rise * state.correction[i, k]
            copy(size, new, z)


@compiled
def move_by_force(
    p: TargetParameters, state: TargetState, force: Floats, span: float, y: Floats, stops: Floats
) -> None:
    """Move the specimen alone, by its model, under a constant force (velocity Verlet).

    M_e a = f - r.

    Parameters
    ----------
    p, state
        Of the target; the state gives the model of the specimen.
    force : ndarray
        Shape (n,), N.
    span : float
        Time, s.
    y, stops : ndarray
        Displacements, then velocities, and stop operators; shapes (2n,), (n, m). Updated.
    """
    n, h = len(p.axes), span / p.substeps
    r, new, moved = state.axes[0], state.axes[1], state.axes[2]
    a, change, sliders = state.springs[3], state.springs[4], state.springs[5]
    for _ in range(p.substeps):
        for side in range(2):
            slider_forces(p.model, state.model.values, stops, sliders)
            specimen_force(p, state, y, sliders, r)
            for i in range(n):
                r[i] = force[i] - r[i]
            times(n, n, p.by_force, r, a)
            for i in range(n):
                y[n + i] += 0.5 * h * a[i]
            if side:
                continue
            for i in range(n):
                new[i] = y[i] + h * y[n + i]
                moved[i] = new[i] - y[i]
            times(n, n, p.deformation, moved, change)
            move_stops(p.model, state.model.thresholds, change, stops)
            copy(n, new, y)
