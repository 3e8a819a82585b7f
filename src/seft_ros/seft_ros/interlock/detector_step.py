"""Analytical redundancy of the channels, step by step, compiled.

What is measured must agree with itself, whatever the specimen is. Over one sampling period, with
displacement x, velocity v, acceleration a, actuator force f and the valve's flow w::

    change of x = integral of v                                                            (1)
    change of v = integral of a                                                            (2)
    integral of w = integral of (v + lambda f / k_oil) + change of f / k_oil               (3)

Each side is summed with a memory of `MEMORY`, so that a slow fault shows, too. The specimen's force
r = f - M a does work on the structure; where the specimen is deformed further, its increment is not
opposed to that of the deformation (Hill's second-order work, 1958)::

    sum dr . dx >= 0                                                                       (4)

What is wrong for a few samples is a spike; each detector has a persistence.
"""

import math

import numpy as np
import numpy.typing as npt
from seft_plant_sim.compiled import compiled

from seft_ros.interlock.detector_arrays import (
    FOLLOWED,
    SIGMAS,
    DetectorParameters,
    DetectorState,
)
from seft_ros.interlock.detector_look import (
    AT_RANGE,
    CHANGE,
    DISPLACEMENT_VELOCITY,
    FROZEN,
    JUMP,
    LIMITED_AT,
    NOISE,
    OIL,
    SAMPLE,
    SECOND_ORDER_WORK,
    TRACKING,
    TURN_AT,
    VELOCITY_ACCELERATION,
    look,
)
from seft_ros.interlock.specimen_detectors import (
    look_at_response,
    look_at_restoring_force,
    look_at_work,
)
from seft_ros.interlock.valve_following import begin_following, follow_valve

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

CHANNEL, OTHER = (0, 1, 3), (1, 2, 1)
"""Channel of each whose change is compared, and with which other."""
ACCELERATION, FORCE = 2, 3
"""Rows of these channels."""
OF_SENSORS = (0, 1, 3, 4, SECOND_ORDER_WORK, JUMP)
"""Those which put a sample under suspicion."""
SOUND, SUSPECT = -1, -2
"""What `detect` gives where no detector ends the test: nothing is beyond its threshold, or the
sample is not to be used."""
LEAST_PRESSURE = 0.2
"""Part of the supply pressure that is always reckoned to be left for the flow."""
MISSED = 2.0
"""Commands in a row that the rig may miss unseen."""
NEVER = -(2**40)
SAME = 1e-9
"""Chance of as many equal samples of a channel that is not frozen."""


@compiled
def begin_detectors(state: DetectorState) -> None:
    """Begin a test."""
    state.sent[:] = 0.0
    begin_following(state.errors, state.covariance)
    state.sums[:] = 0.0
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
    """Remember the command that answers the last sample, (n,), V, and whether it is limited."""
    if limited:
        state.step[LIMITED_AT] = state.step[SAMPLE]
    for i in range(len(command)):
        for j in range(state.sent.shape[1] - 1, 0, -1):
            state.sent[i, j] = state.sent[i, j - 1]
        load = under_load(command[i], state.last[3, i], p.actuator[i, 3])
        state.sent[i, 0] = command[i] * load


@compiled
def find_flow(p: DetectorParameters, state: DetectorState, lost: int) -> None:
    """Find the flow of each valve now; where samples were lost, the last command was held."""
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
    """Give the first of two findings that is one."""
    return found if found >= 0 else other


@compiled
def detect(
    p: DetectorParameters, state: DetectorState, step: int, points: Floats, measured: Floats
) -> int:
    """Take a sample in; say which detector ends the test, row * n + axis, or `SOUND` or `SUSPECT`.

    Parameters
    ----------
    p, state
        The state is brought up to date.
    step : int
        Of the sample. Where that of the step before is missing, nothing is compared; what is at the
        end of a sensor's range is not, either.
    points : ndarray
        Of the reference force, shape (h + 1, q, n); q is 3 where it is of a target.
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
    """Whether the specimen is where the target is, while the valve can bring it there."""
    away = abs(points[0, 0, i] - measured[0, i])
    largest = max(abs(points[0, 0, i]), abs(measured[0, i]), p.memory * state.largest[6, i])
    state.largest[6, i] = largest
    threshold = p.sums[DISPLACEMENT_VELOCITY, i] + p.off_target * largest
    if step - state.step[LIMITED_AT] <= p.limited:
        threshold = np.inf  # the interlock counts these
    is_off = look(p, state, TRACKING, i, away, threshold)
    return TRACKING * measured.shape[1] + i if is_off else -1


@compiled
def _relations(
    p: DetectorParameters, state: DetectorState, step: int, measured: Floats, i: int
) -> int:
    """Relations (1) to (3) of an axis."""
    n, dt, last, found = measured.shape[1], p.dt, state.last, -1
    oil, leakage = p.actuator[i, 1], p.actuator[i, 2]
    moved = 0.5 * dt * (measured[1, i] + last[1, i])
    for relation in range(3):
        if not (sees(state, step, CHANNEL[relation]) and sees(state, step, OTHER[relation])):
            continue
        if relation == DISPLACEMENT_VELOCITY:
            one, other = measured[0, i] - last[0, i], moved
        elif relation == VELOCITY_ACCELERATION:
            one = measured[1, i] - last[1, i]
            other = 0.5 * dt * (measured[2, i] + last[2, i])
        else:
            flow = 0.5 * (state.flow[0, i] + state.flow[1, i])
            later = 0.5 * (state.later[0, i] + state.later[1, i])
            other = 0.5 * dt * leakage * (measured[3, i] + last[3, i])
            other = moved + (measured[3, i] - last[3, i] + other) / oil
            errors, covariance = state.errors[i], state.covariance[i]
            one = dt * (flow + errors[0] * flow + errors[1] * later)
            if state.counts[NOISE + OIL, i] == 0 and state.counts[CHANGE + OIL, i] == 0:
                follow_valve(errors, covariance, flow, later, other / dt, p.doubt[i])
        sums, largest = state.sums[relation], state.largest
        sums[0, i] = p.fade * sums[0, i] + one
        sums[1, i] = p.fade * sums[1, i] + other
        whole = max(abs(sums[0, i]), abs(sums[1, i]), p.memory * largest[relation, i])
        single = max(abs(one), abs(other), p.fade * largest[3 + relation, i])
        largest[relation, i], largest[3 + relation, i] = whole, single
        tolerance, coarse = p.tolerance[relation], state.resolution[CHANNEL[relation], i]
        coarse = coarse / oil if relation == OIL else coarse
        coarse = 2.0 * coarse if coarse < np.inf else 0.0
        if relation == OIL:  # the rig may have missed commands, and held the one before
            change = abs(state.flow[1, i] - state.flow[0, i])
            largest[8, i] = max(change, p.fade * largest[8, i])
            coarse += MISSED * dt * largest[8, i]
        elif relation == VELOCITY_ACCELERATION:  # a force may have jumped between the samples
            coarse += 0.5 * dt * abs(measured[2, i] - last[2, i])
        off, threshold = abs(sums[0, i] - sums[1, i]), p.sums[relation, i] + tolerance * whole
        threshold += coarse
        if look(p, state, CHANGE + relation, i, off, threshold) and found < 0:
            found = (CHANGE + relation) * n + i
        if relation == OIL:
            tolerance = min(tolerance, FOLLOWED + SIGMAS * math.sqrt(covariance[0]))
        off, threshold = abs(one - other), p.steps[relation, i] + tolerance * single + coarse
        if look(p, state, NOISE + relation, i, off, threshold) and found < 0:
            found = (NOISE + relation) * n + i
    return found


@compiled
def _channels(
    p: DetectorParameters, state: DetectorState, step: int, measured: Floats, i: int
) -> int:
    """Whether a channel of an axis repeats one value."""
    n, found = measured.shape[1], -1
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
    """Take in the samples of a whole test.

    Parameters
    ----------
    p, state
        The state, which has begun, is brought up to date.
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
