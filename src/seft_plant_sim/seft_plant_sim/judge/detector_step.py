"""The detectors, step by step: `judge_sample` passes a judged sample to each of them.

The measured channels must agree with each other (`channel_relations`), with what a specimen can do
(`specimen_force`). A deviation of a few samples is a spike, so each detector
has a persistence.
"""

import math

import numpy as np
from seft_msgs_py.arrays import Floats, Ints, clear

from seft_plant_sim.channels import ACCELERATION, FORCE
from seft_plant_sim.compiled import compiled, copy, put_first
from seft_plant_sim.judge import detectors, specimen_force
from seft_plant_sim.judge.channel_relations import begin_relations, find_flow, relations
from seft_plant_sim.judge.detectors import OIL, DetectorParameters, DetectorState, first_of, look
from seft_plant_sim.judge.hypotheses import FORCES
from seft_plant_sim.judge.judge import ANY_ROW, MOST, SEVERAL_ROW, JudgeState
from seft_plant_sim.judge.judge_step import LONG_AGO, SURE, ask, begin_judge, is_replaced, judge
from seft_plant_sim.judge.known_rig import CAPACITY, FLOW_GAIN
from seft_plant_sim.judge.relation_following import expected, uncertain
from seft_plant_sim.judge.valve_following import under_load

OF_SENSORS = (0, 1, detectors.SECOND_ORDER_WORK, detectors.JUMP)
"""Detectors that make a sample suspect."""

SAME, SUSPECTED = 1e-11, 2.0 / 3.0
"""Chance of so many equal samples of a channel that is not frozen, and the part of these samples
after which a sample is suspect: a chance of 5e-8."""


def begin_detectors(p: DetectorParameters, state: DetectorState) -> None:
    """Begin a test."""
    clear(state[:-1])
    state.step[:] = LONG_AGO
    state.step[detectors.AT_RANGE :] = p.rig.waits - 1  # nothing new is seen before
    begin_relations(p, state)
    begin_judge(p.judge, state.judge)


@compiled
def judge_sample(
    p: DetectorParameters,
    state: DetectorState,
    step: int,
    raw: Floats,
    drive: Floats,
    judged: Floats,
) -> int:
    """Judge a sample, and look for faults.

    Give the detector that ends the test, row * n + axis, `VALID` or `SUSPECT`.

    Parameters
    ----------
    p, state
        The state is updated.
    step : int
        Of the sample. Nothing is compared if the sample before is missing; a channel is not used if
        it is at the end of its sensor's range.
    raw, drive : ndarray
        Displacement, velocity, acceleration and force, shape (4, n), and what the rig applies from
        this sample on (V, or N if it obeys forces), shape (n,).
    judged : ndarray
        The sample for the loop, finite, see `judge`; shape (4, n). The result.
    """
    # beyond 60 lines: the order of what looks at a sample stands in one place
    n, found = raw.shape[1], detectors.VALID
    lost = step - state.step[detectors.SAMPLE] - 1
    for row in range(4):
        for i in range(n):
            if abs(raw[row, i]) >= p.rig.ranges[row, i]:
                state.step[detectors.AT_RANGE + row] = step
    is_first = lost > 0
    state.step[detectors.SAMPLE] = step
    if p.rig.has_valve:
        find_flow(p, state, lost, drive)
    for i in range(n):
        if not p.rig.has_valve:
            ask(p.judge.axes[i], state.judge.axes[i], drive[i])
        flow = state.flow[0, i]
        load = under_load(flow, state.last[3, i], p.rig.actuator[i, CAPACITY])
        mean, later = load * flow, load * state.flow[1, i]
        # a valve that is open opens no further; where the limit of its command lies below, it does
        most = p.rig.actuator[i, FLOW_GAIN] * p.rig.largest_drive
        beyond = 0.5 * load * max(abs(flow) - most, 0.0)
        state.mean[1, i] = uncertain(state.covariance[OIL, i], mean, later, 1.0) + beyond * beyond
        mean -= math.copysign(beyond, mean)
        state.mean[0, i] = expected(state.estimated[OIL], i, mean, later, 1.0)
    judge(p.judge, state.judge, step, raw, state.mean, judged)
    last, restoring = state.last, state.restoring
    copy(n, state.judge.restoring, restoring[1])
    if not is_first:
        for i in range(n):
            if judged[1, i] * last[1, i] <= 0.0:
                state.step[detectors.TURN_AT] = step
        knows_force = detectors.sees(state, step, ACCELERATION)
        knows_force &= detectors.sees(state, step, FORCE)
        if knows_force:
            found = first_of(found, specimen_force.look_at_work(p, state, judged))
            found = first_of(found, specimen_force.look_at_strength(p, state, judged))
        for i in range(n):
            found = first_of(found, relations(p, state, step, judged, i))
            found = first_of(found, look_for_frozen(p, state, step, i))
            if knows_force:
                jump = specimen_force.look_at_restoring_force(p, state, step, judged, i)
                found = first_of(found, jump)
    for i in range(n):
        known = 0.0 if is_first else 1.0
        put_first(state.changes[i, 0], known * (restoring[1, i] - restoring[0, i]))
        put_first(state.changes[i, 1], known * (judged[0, i] - last[0, i]))
        restoring[0, i] = restoring[1, i]
        for row in range(4):
            last[row, i] = judged[row, i]
        found = first_of(found, look_for_wrong(p, state, i))
        for row in OF_SENSORS:
            if state.counts[row, i] and p.acts[row]:
                found = first_of(found, detectors.SUSPECT)
    return found


@compiled
def look_for_wrong(p: DetectorParameters, state: DetectorState, i: int) -> int:
    """Whether samples of an axis were wrong too often; the second such sample is suspect.

    So is one where the amplifier may have failed: by another history that is not unlikely.
    """
    found, counts, axis = detectors.VALID, state.judge.counts, state.judge.axes[i]
    for j in range(1, axis.count):
        wrong = axis.alive[j].wrong[0] & ~axis.alive[0].wrong[0] & FORCES
        if wrong == FORCES and axis.alive[j].weight > SURE and p.acts[detectors.WRONG + FORCE]:
            found = detectors.SUSPECT
    often = max(counts[0, i], counts[1, i], counts[2, i], counts[3, i])
    for row in range(4):
        count = counts[row, i]
        if not (count or state.counts[detectors.WRONG + row, i]):
            continue  # it is right, as nearly always
        most = p.judge.most
        if count == often:  # of all that were wrong, it is named
            count = counts[ANY_ROW, i]
            if counts[SEVERAL_ROW, i] >= MOST:
                count, most = counts[SEVERAL_ROW, i], MOST
        found = first_of(found, look(p, state, detectors.WRONG + row, i, float(count), most - 0.5))
        if count > 1 and is_replaced(state.judge, 0, row, i) and p.acts[detectors.WRONG + row]:
            found = first_of(found, detectors.SUSPECT)
    return found


@compiled
def look_for_frozen(p: DetectorParameters, state: DetectorState, step: int, i: int) -> int:
    """Whether channels of an axis repeat one value each, as measured.

    The chances of the others count: what one amplifier or converter gives freezes together.
    """
    found, judge, whole = detectors.VALID, state.judge, 0.0
    for row in range(4):
        moved = judge.moved[row, i] != 0.0 or not detectors.sees(state, step, row)
        state.repeats[row, i] = 0 if moved else state.repeats[row, i] + 1
        if state.repeats[row, i]:
            whole += state.repeats[row, i] * log_same(p, judge, row, i)
    for row in range(4):
        if not (state.repeats[row, i] or state.counts[detectors.FROZEN + row, i]):
            continue  # it moves, as nearly always
        repeats, threshold = float(state.repeats[row, i]), np.inf
        if whole < 0.0 and repeats > 0.0:
            threshold = repeats * math.log(SAME) / whole
        found = first_of(found, look(p, state, detectors.FROZEN + row, i, repeats, threshold))
        if repeats > SUSPECTED * threshold and p.acts[detectors.FROZEN + row]:
            found = first_of(found, detectors.SUSPECT)
    return found


@compiled
def log_same(p: DetectorParameters, judge: JudgeState, row: int, i: int) -> float:
    """Logarithm of the chance of a channel's same value twice; 0 if that is likely.

    The chance is the step of its converter over 2 sqrt(pi) times the noise.
    """
    chance = judge.resolution[row, i] / (2.0 * math.sqrt(math.pi) * p.rig.noise[row, i])
    return math.log(chance) if chance < 0.5 else 0.0


@compiled
def detect_all(
    p: DetectorParameters,
    state: DetectorState,
    steps: Ints,
    measured: Floats,
    drives: Floats,
    judged: Floats,
) -> None:
    """Look at the samples of a whole test.

    Parameters
    ----------
    p, state
        The state, after its begin; it is updated.
    steps, measured, drives : ndarray
        Steps of the N samples, (N,); samples as measured, and the rig's drive; shapes (N, 4, n)
        and (N, n).
    judged : ndarray
        Shape (4, n), a work array.
    """
    for k in range(len(steps)):
        judge_sample(p, state, steps[k], measured[k], drives[k], judged)
