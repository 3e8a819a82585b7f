"""Analytical redundancy of the channels, step by step, compiled.

The measured channels must agree with each other, for any specimen. Over one sampling period, with
displacement x, velocity v, acceleration a, actuator force f and the valve's flow w::

    change of x = integral of v                                                            (1)
    change of v = integral of a                                                            (2)
    integral of w = integral of (v + lambda f / k_oil) + change of f / k_oil               (3)

Each side is summed with a memory of `MEMORY`, so that slow faults show, too. The mean of their
recent differences, which is the bias of a sensor, is subtracted. The specimen's force
r = f - M a does work on the structure; while the specimen is deformed further, the increment of r
does not oppose that of the deformation (Hill's second-order work, 1958)::

    sum dr . dx >= 0                                                                       (4)

A deviation of a few samples is a spike, so each detector has a persistence.

`detect` passes the samples to all detectors.
"""

import math
from typing import NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats, Ints
from seft_plant_sim.compiled import compiled

from seft_ros.protection.detectors import (
    AT_RANGE,
    CHANGE,
    DISPLACEMENT_VELOCITY,
    FOLLOWED,
    FROZEN,
    JUMP,
    LIMITED_AT,
    NO_RESPONSE,
    NOISE,
    OIL,
    ROUGH,
    SAMPLE,
    SECOND_ORDER_WORK,
    SIGMAS,
    TRACKING,
    TURN_AT,
    VELOCITY_ACCELERATION,
    DetectorParameters,
    DetectorState,
    begin_following,
    follow_valve,
    look,
)

OPPOSED = 0.5
"""Part of the assumed stiffness by which a specimen may soften: fracture, buckling."""
SLIP, BREAK, STIFFEST = 0.35, 0.25, 6.0
"""Largest change of a specimen's force in a step: parts of its largest force, with and against the
motion; with the motion, in addition, so many times the assumed stiffness."""
TURNED, TURN, MOVES = 3, 2.0, 0.2
"""Samples after a turn of the motion in which friction reverses, the change of the force by that,
and the part of the fastest recent motion above which a specimen does not stick."""
SILENT = 25.0
"""Mean square of the change of the computed mass's force over that of the noise, above which a
measured force that is only noise does not answer the motion."""
ALTERNATE = 0.33
"""Part of the recent samples at which r alternates: white noise far beyond its threshold does so in
2 of 3, a specimen with impacts or a ringing oil column in 1 of 3."""


@compiled
def look_at_restoring_force(
    p: DetectorParameters, state: DetectorState, step: int, measured: Floats, i: int
) -> int:
    """Whether the specimen's force jumps, once or from sample to sample as with noise."""
    n, found, last, r = measured.shape[1], -1, state.last, state.restoring
    curvature = rise = fall = 0.0
    for k in range(n):
        spring = p.stiffness[i, k] * (measured[0, k] - last[0, k])
        rise, fall = rise + max(spring, 0.0), fall + max(-spring, 0.0)
        curvature += p.stiffness[i, k] * p.dt * p.dt * (measured[2, k] + last[2, k])
    change, moved = r[2, i] - r[0, i], abs(measured[0, i] - last[0, i])
    moves = p.steps[DISPLACEMENT_VELOCITY, i] + MOVES * state.largest[3, i]
    slips = moved < moves or step - state.step[TURN_AT] <= TURNED
    largest = state.largest[7, i]
    if state.counts[JUMP, i] == 0:  # a suspect sample is no measure
        largest = max(abs(r[0, i]), p.memory * largest)
        state.largest[7, i] = largest
    # noise alternates, an impact rings
    bend, limit = change - r[1, i], p.rough[i] + abs(curvature) + (TURN * largest if slips else 0.0)
    bend = bend if abs(bend) > limit else 0.0
    alternates = 1.0 if bend * state.bends[0, i] < 0.0 else 0.0
    state.bends[0, i] = bend
    if alternates or not slips:
        state.bends[1, i] = p.short * state.bends[1, i] + alternates
    if look(p, state, ROUGH, i, state.bends[1, i], ALTERNATE / (1.0 - p.short)):
        found = ROUGH * n + i
    # after a jump, r must stay there
    jump = change + (r[1, i] if state.counts[JUMP, i] else 0.0)
    stiff = STIFFEST * (rise if jump > 0.0 else fall)
    part = TURN if slips else (SLIP if stiff > 0.0 else BREAK)
    threshold = part * largest + p.rough[i] + stiff
    if look(p, state, JUMP, i, abs(jump), threshold) and found < 0:
        found = JUMP * n + i
    return found


@compiled
def look_at_response(p: DetectorParameters, state: DetectorState, measured: Floats, i: int) -> int:
    """Whether a force is only noise, while the computed mass alone requires far more."""
    n, last, response = measured.shape[1], state.last, state.response
    inertia = hiss = 0.0
    for k in range(n):
        inertia += p.computed_mass[i, k] * (measured[2, k] - last[2, k])
        hiss += 2.0 * (p.computed_mass[i, k] * p.noise[2, k]) ** 2
    response[0, i] = p.short * response[0, i] + (measured[3, i] - last[3, i]) ** 2
    response[1, i] = p.short * response[1, i] + inertia * inertia
    white, samples = 2.0 * p.noise[3, i] ** 2, 1.0 / (1.0 - p.short)
    is_noise = response[0, i] < 2.0 * samples * white
    threshold = SILENT * samples * (white + hiss) if is_noise else np.inf
    return NO_RESPONSE * n + i if look(p, state, NO_RESPONSE, i, response[1, i], threshold) else -1


@compiled
def look_at_work(p: DetectorParameters, state: DetectorState, measured: Floats) -> int:
    """Relation (4) of `detector_step`, over all axes."""
    n, last, r, work = measured.shape[1], state.last, state.restoring, state.work
    for row in range(3):
        work[row] *= p.short
    for i in range(n):
        moved, change = measured[0, i] - last[0, i], r[2, i] - r[0, i]
        noise = p.noise[3, i] ** 2
        for k in range(n):
            noise += (p.mass[i, k] * p.noise[2, k]) ** 2
            work[1] += moved * p.stiffness[i, k] * (measured[0, k] - last[0, k])
        work[0] += change * moved
        work[2] += 2.0 * (noise * moved * moved + (p.noise[0, i] * change) ** 2)
    threshold = OPPOSED * work[1] + 6.0 * math.sqrt(work[2]) + p.unknown
    return (
        SECOND_ORDER_WORK * n if look(p, state, SECOND_ORDER_WORK, 0, -work[0], threshold) else -1
    )


DISPLACEMENT, VELOCITY, ACCELERATION, FORCE = range(4)
"""Rows of the channels."""
OF_SENSORS = (0, 1, 3, 4, SECOND_ORDER_WORK, JUMP)
"""Detectors that make a sample suspect."""
SOUND, SUSPECT = -1, -2
"""Results of `detect` if no detector ends the test: nothing is beyond its threshold, or the sample
must not be used."""
LEAST_PRESSURE = 0.2
"""Part of the supply pressure that is always assumed to be left for the flow."""
MISSED = 2.0
"""Commands in a row that the rig may miss without a sample beyond its threshold."""
NEVER = -(2**40)
SAME, SUSPECTED = 1e-9, 2.0 / 3.0
"""Chance of so many equal samples of a channel that is not frozen, and the part of these samples
after which a sample is suspect: a chance of 1e-6."""


@compiled
def begin_detectors(state: DetectorState) -> None:
    """Begin a test."""
    state.sent[:] = 0.0
    begin_following(state.errors, state.covariance)
    state.sums[:] = 0.0
    state.flows[:] = 0.0
    state.rise[:] = 0.0
    state.bias[:, 0] = 0.0
    state.bias[:, 1] = 1.0
    state.largest[:] = 0.0
    state.work[:] = 0.0
    state.response[:] = 0.0
    state.bends[:] = 0.0
    state.repeats[:] = 0
    state.resolution[:] = np.inf
    state.counts[:] = 0
    state.shares[:] = 0.0
    state.step[:] = NEVER


@compiled
def under_load(direction: float, force: float, capacity: float) -> float:
    """Flow of a valve that opens in a direction, over that without load (Merritt 1967)."""
    left = 1.0 - force / capacity if direction > 0.0 else 1.0 + force / capacity
    return math.sqrt(max(left, LEAST_PRESSURE))


@compiled
def take_command(
    p: DetectorParameters, state: DetectorState, command: Floats, limited: bool
) -> None:
    """Store the command that answers the last sample, (n,), V, and whether it is limited."""
    if limited:
        state.step[LIMITED_AT] = state.step[SAMPLE]
    for i in range(len(command)):
        for j in range(state.sent.shape[1] - 1, 0, -1):
            state.sent[i, j] = state.sent[i, j - 1]
        load = under_load(command[i], state.last[3, i], p.actuator[i, 3])
        state.sent[i, 0] = command[i] * load


@compiled
def find_flow(p: DetectorParameters, state: DetectorState, lost: int) -> None:
    """Find the present flow of each valve; if samples were lost, the last command was held."""
    for i in range(len(state.flow[0])):
        for _ in range(min(lost, state.sent.shape[1])):
            for j in range(state.sent.shape[1] - 1, 0, -1):
                state.sent[i, j] = state.sent[i, j - 1]
        flow = later = 0.0
        for j in range(state.sent.shape[1]):
            flow += p.past[0, i, j] * state.sent[i, j]
            later += p.past[1, i, j] * state.sent[i, j]
        state.flow[0, i], state.flow[1, i] = state.flow[1, i], p.actuator[i, 0] * flow
        state.later[0, i], state.later[1, i] = state.later[1, i], p.actuator[i, 0] * later


@compiled
def sees(state: DetectorState, step: int, row: int) -> bool:
    """Say whether a channel was within its range at this sample and the last one."""
    return step - state.step[AT_RANGE + row] > 1


@compiled
def worse(found: int, other: int) -> int:
    """Give the first finding of a fault; without one, whether the sample is suspect."""
    if found < 0 <= other:
        return other
    return found if found >= 0 else min(found, other)


@compiled
def detect(
    p: DetectorParameters, state: DetectorState, step: int, points: Floats, measured: Floats
) -> int:
    """Check a sample; give the detector that ends the test, row * n + axis, `SOUND` or `SUSPECT`.

    Parameters
    ----------
    p, state
        The state is updated.
    step : int
        Of the sample. Nothing is compared if the sample before is missing; a channel is not used if
        it is at the end of its sensor's range.
    points : ndarray
        Of the reference force, shape (h + 1, q, n); q is 3 for a target.
    measured : ndarray
        Displacement, velocity, acceleration and force, finite, shape (4, n).
    """
    n, found = measured.shape[1], SOUND
    lost = step - state.step[SAMPLE] - 1
    for row in range(4):
        for i in range(n):
            if abs(measured[row, i]) >= p.range[row, i]:
                state.step[AT_RANGE + row] = step
    is_first = lost > 0
    state.step[SAMPLE] = step
    find_flow(p, state, lost)
    last, restoring = state.last, state.restoring
    for i in range(n):
        total = measured[3, i]
        for k in range(n):
            total -= p.mass[i, k] * measured[2, k]
        restoring[2, i] = total
    if not is_first:
        for i in range(n):
            if measured[1, i] * last[1, i] <= 0.0:
                state.step[TURN_AT] = step
        knows_force = sees(state, step, ACCELERATION) and sees(state, step, FORCE)
        if knows_force:
            found = worse(found, look_at_work(p, state, measured))
        for i in range(n):
            found = worse(found, _relations(p, state, step, measured, i))
            found = worse(found, _channels(p, state, step, measured, i))
            if knows_force:
                found = worse(found, look_at_restoring_force(p, state, step, measured, i))
                found = worse(found, look_at_response(p, state, measured, i))
            if points.shape[1] > 1:
                found = worse(found, _tracking(p, state, step, points, measured, i))
    for i in range(n):
        restoring[1, i] = 0.0 if is_first else restoring[2, i] - restoring[0, i]
        restoring[0, i] = restoring[2, i]
        for row in range(4):
            last[row, i] = measured[row, i]
    if found < 0:
        for row in OF_SENSORS:
            for i in range(n):
                if state.counts[row, i] and p.acts[row]:
                    return SUSPECT
    return found


@compiled
def _tracking(
    p: DetectorParameters, state: DetectorState, step: int, points: Floats, measured: Floats, i: int
) -> int:
    """Whether the specimen is away from the target, although the valve is not at its limit."""
    away = abs(points[0, 0, i] - measured[0, i])
    largest = max(abs(points[0, 0, i]), abs(measured[0, i]), p.memory * state.largest[6, i])
    state.largest[6, i] = largest
    bias = p.bias[DISPLACEMENT_VELOCITY, i] / (1.0 - p.fade)
    threshold = p.sums[DISPLACEMENT_VELOCITY, i] + bias + p.off_target * largest
    if step - state.step[LIMITED_AT] <= p.limited:
        threshold = np.inf  # the interlock counts these
    is_off = look(p, state, TRACKING, i, away, threshold)
    return TRACKING * measured.shape[1] + i if is_off else -1


@compiled
def hold(flows: Floats, newest: float) -> tuple[float, float]:
    """Store a flow; give the least and the largest of those that the rig may hold."""
    least = largest = newest
    for j in range(len(flows) - 1, 0, -1):
        flows[j] = flows[j - 1]
        least, largest = min(least, flows[j]), max(largest, flows[j])
    flows[0] = newest
    return least, largest


class Sides(NamedTuple):
    """The sides of a relation over one period, and what may make them differ."""

    one: float
    other: float
    least: float
    """Least and largest value of the first side if the rig holds a command."""
    largest: float
    in_sums: float
    """Difference that the times of the samples cause in the sums, and in one period."""
    in_step: float
    part: float
    """Relative error of the first side."""
    resolution: float
    """Of the first side."""
    missed: float
    """Difference that missed commands cause."""


@compiled
def look_at_sides(
    p: DetectorParameters,
    state: DetectorState,
    row: int,
    i: int,
    sides: tuple[float, float, float, float],
    threshold: float,
    missed: float,
) -> bool:
    """Compare the sides of a relation.

    Parameters
    ----------
    p, state, row, i
        See `look`.
    sides : tuple of float
        One side, the other, and the least and the largest value of the first if the rig holds a
        command.
    threshold : float
        Difference above which no held command explains it.
    missed : float
        Further difference that missed commands may cause.
    """
    one, other, least, largest = sides
    beyond = max(other - largest, least - other)
    if beyond > threshold:
        return look(p, state, row, i, beyond, threshold, p.samples[row])
    return look(p, state, row, i, abs(one - other), threshold + missed)


@compiled
def _resolution(state: DetectorState, row: int, i: int) -> float:
    """Resolution of a change of a channel; 0 as long as it is not known."""
    resolution = 2.0 * state.resolution[row, i]
    return resolution if resolution < np.inf else 0.0


@compiled
def _displacement_sides(
    p: DetectorParameters, state: DetectorState, measured: Floats, i: int
) -> Sides:
    """Relation (1)."""
    last = state.last
    one, other = measured[0, i] - last[0, i], 0.5 * p.dt * (measured[1, i] + last[1, i])
    late = p.late * abs(measured[1, i] - last[1, i])  # of a derived velocity
    part = p.tolerance[DISPLACEMENT_VELOCITY]
    return Sides(one, other, one, one, late, late, part, _resolution(state, 0, i), 0.0)


@compiled
def _velocity_sides(p: DetectorParameters, state: DetectorState, measured: Floats, i: int) -> Sides:
    """Relation (2); a force may jump at any time between two samples."""
    last, rise = state.last, measured[2, i] - state.last[2, i]
    one, other = measured[1, i] - last[1, i], 0.5 * p.dt * (measured[2, i] + last[2, i])
    state.rise[i] = p.fade * state.rise[i] + rise
    at = 0.5 * p.dt + p.late
    in_sums, in_step = at * max(abs(rise), abs(state.rise[i])), at * abs(rise)
    part = p.tolerance[VELOCITY_ACCELERATION]
    return Sides(one, other, one, one, in_sums, in_step, part, _resolution(state, 1, i), 0.0)


@compiled
def _oil_sides(p: DetectorParameters, state: DetectorState, measured: Floats, i: int) -> Sides:
    """Relation (3), with the valve as it was found so far."""
    dt, last, errors, covariance = p.dt, state.last, state.errors[i], state.covariance[i]
    oil, leakage = p.actuator[i, 1], p.actuator[i, 2]
    flow = 0.5 * (state.flow[0, i] + state.flow[1, i])
    later = 0.5 * (state.later[0, i] + state.later[1, i])
    moved = 0.5 * dt * (measured[1, i] + last[1, i])
    leaked = 0.5 * dt * leakage * (measured[3, i] + last[3, i])
    other = moved + (measured[3, i] - last[3, i] + leaked) / oil
    one = dt * (flow + errors[0] * flow + errors[1] * later)
    least, largest = hold(state.flows[i], one)
    if state.counts[NOISE + OIL, i] == 0 and state.counts[CHANGE + OIL, i] == 0:
        follow_valve(errors, covariance, flow, later, other / dt, p.doubt[i])
    part = min(p.tolerance[OIL], FOLLOWED + SIGMAS * math.sqrt(covariance[0]))
    change = abs(state.flow[1, i] - state.flow[0, i])
    state.largest[8, i] = max(change, p.fade * state.largest[8, i])
    missed = MISSED * dt * state.largest[8, i]
    resolution = _resolution(state, FORCE, i) / oil
    return Sides(one, other, least, largest, 0.0, 0.0, part, resolution, missed)


@compiled
def _compare(
    p: DetectorParameters, state: DetectorState, relation: int, n: int, i: int, sides: Sides
) -> int:
    """Compare the sides of a relation, less their bias, over a period and as sums."""
    recent, bias, found = state.largest, state.bias[relation], -1
    one, other = sides.one, sides.other + bias[0, i]
    if state.counts[NOISE + relation, i] == 0 and state.counts[CHANGE + relation, i] == 0:
        constant = bias[0, i] + (1.0 - p.memory) * (one - other)
        bias[0, i] = min(max(constant, -p.bias[relation, i]), p.bias[relation, i])
        bias[1, i] *= p.memory
    now, sums = (one, other, sides.least, sides.largest), state.sums[relation]
    for row in range(4):
        sums[row, i] = p.fade * sums[row, i] + now[row]
    summed = (sums[0, i], sums[1, i], sums[2, i], sums[3, i])
    whole = max(abs(sums[0, i]), abs(sums[1, i]), p.memory * recent[relation, i])
    single = max(abs(one), abs(other), p.fade * recent[3 + relation, i])
    recent[relation, i], recent[3 + relation, i] = whole, single
    unknown = p.bias[relation, i] * bias[1, i] / (1.0 - p.fade)
    known, missed = sides.resolution, sides.missed
    threshold = p.sums[relation, i] + unknown + p.tolerance[relation] * whole + known
    threshold += sides.in_sums
    if look_at_sides(p, state, CHANGE + relation, i, summed, threshold, missed):
        found = (CHANGE + relation) * n + i
    threshold = p.steps[relation, i] + sides.part * single + known + sides.in_step
    if look_at_sides(p, state, NOISE + relation, i, now, threshold, missed) and found < 0:
        found = (NOISE + relation) * n + i
    return found


@compiled
def _relations(
    p: DetectorParameters, state: DetectorState, step: int, measured: Floats, i: int
) -> int:
    """Relations (1) to (3) of an axis."""
    n, found = measured.shape[1], -1
    sees_velocity = sees(state, step, VELOCITY)
    if sees_velocity and sees(state, step, DISPLACEMENT):
        sides = _displacement_sides(p, state, measured, i)
        found = _compare(p, state, DISPLACEMENT_VELOCITY, n, i, sides)
    if sees_velocity and sees(state, step, ACCELERATION):
        sides = _velocity_sides(p, state, measured, i)
        found = worse(found, _compare(p, state, VELOCITY_ACCELERATION, n, i, sides))
    if sees_velocity and sees(state, step, FORCE):
        sides = _oil_sides(p, state, measured, i)
        found = worse(found, _compare(p, state, OIL, n, i, sides))
    return found


@compiled
def _channels(
    p: DetectorParameters, state: DetectorState, step: int, measured: Floats, i: int
) -> int:
    """Whether a channel of an axis repeats one value."""
    n, found = measured.shape[1], SOUND
    for row in range(4):
        if not sees(state, step, row):
            continue
        change, seen, threshold = abs(measured[row, i] - state.last[row, i]), 0.0, np.inf
        if change > 0.0:
            state.repeats[row, i] = 0
            if change < state.resolution[row, i]:
                state.resolution[row, i] = change
        else:
            state.repeats[row, i] += 1
            seen = float(state.repeats[row, i])
            # the chance of the same value twice is its step over 2 sqrt(pi) times the noise
            chance = state.resolution[row, i] / (2.0 * math.sqrt(math.pi) * p.dither[row, i])
            threshold = math.log(SAME) / math.log(chance) if chance < 0.5 else np.inf
        if look(p, state, FROZEN + row, i, seen, threshold) and found < 0:
            found = (FROZEN + row) * n + i
        if seen > SUSPECTED * threshold and p.acts[FROZEN + row]:
            found = worse(found, SUSPECT)
    return found


@compiled
def detect_all(
    p: DetectorParameters,
    state: DetectorState,
    steps: Ints,
    points: Floats,
    states: Floats,
    commands: Floats,
    limit: float,
) -> None:
    """Check the samples of a whole test.

    Parameters
    ----------
    p, state
        The state, after its begin; it is updated.
    steps : ndarray
        Of the N samples, shape (N,).
    points, states, commands : ndarray
        Reference force, state and valve command at these, shapes (N, q, n), (N, 4, n) and (N, n).
    limit : float
        Largest command, V.
    """
    for k in range(len(steps)):
        detect(p, state, steps[k], points[k : k + 1], states[k])
        limited = False
        for i in range(commands.shape[1]):
            limited |= abs(commands[k, i]) >= limit
        take_command(p, state, commands[k], limited)
