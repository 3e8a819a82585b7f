"""The detectors, step by step: `detect` passes a sample to each of them.

The measured channels must agree with each other (`channel_relations`), with what a specimen can do
(`specimen_force`) and with the target. A deviation of a few samples is a spike, so each detector
has a persistence.
"""

import math

import numpy as np
from seft_msgs_py.arrays import Floats, Ints
from seft_plant_sim.compiled import compiled

from seft_ros.protection.channel_relations import find_flow, relations, take_command
from seft_ros.protection.detectors import (
    ACCELERATION,
    AT_RANGE,
    DISPLACEMENT_VELOCITY,
    FORCE_CHANNEL,
    FROZEN,
    JUMP,
    LIMITED_AT,
    SAMPLE,
    SECOND_ORDER_WORK,
    SUSPECT,
    TRACKING,
    TURN_AT,
    VALID,
    DetectorParameters,
    DetectorState,
    look,
    more_severe,
    sees,
)
from seft_ros.protection.specimen_force import (
    look_at_response,
    look_at_restoring_force,
    look_at_work,
)
from seft_ros.protection.valve_following import begin_following

OF_SENSORS = (0, 1, 3, 4, SECOND_ORDER_WORK, JUMP)
"""Detectors that make a sample suspect."""

_NEVER = -(2**40)

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
    state.step[:] = _NEVER


@compiled
def detect(
    p: DetectorParameters, state: DetectorState, step: int, points: Floats, measured: Floats
) -> int:
    """Check a sample; give the detector that ends the test, row * n + axis, `VALID` or `SUSPECT`.

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
    n, found = measured.shape[1], VALID
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
        knows_force = sees(state, step, ACCELERATION) and sees(state, step, FORCE_CHANNEL)
        if knows_force:
            found = more_severe(found, look_at_work(p, state, measured))
        for i in range(n):
            found = more_severe(found, relations(p, state, step, measured, i))
            found = more_severe(found, look_for_frozen(p, state, step, measured, i))
            if knows_force:
                found = more_severe(found, look_at_restoring_force(p, state, step, measured, i))
                found = more_severe(found, look_at_response(p, state, measured, i))
            if points.shape[1] > 1:
                found = more_severe(found, look_at_tracking(p, state, step, points, measured, i))
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
def look_at_tracking(
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
def look_for_frozen(
    p: DetectorParameters, state: DetectorState, step: int, measured: Floats, i: int
) -> int:
    """Whether a channel of an axis repeats one value."""
    n, found = measured.shape[1], VALID
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
            found = more_severe(found, SUSPECT)
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
