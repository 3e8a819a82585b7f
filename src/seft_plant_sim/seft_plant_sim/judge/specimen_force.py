"""The specimen's force by the measured force and acceleration, which must fit its motion.

The specimen's force r = f - M a does work on the structure; while the specimen is deformed further,
the increment of r does not oppose that of the deformation (Hill's second-order work, 1958)::

    sum dr . dx >= 0                                                                       (4)

Where the specimen is deformed as far as never before in a direction, it still carries a part of the
force that it had there. Nor does its force jump further than friction and gaps make it.
"""

import math

import numpy as np
from seft_msgs_py.arrays import Floats

from seft_plant_sim.compiled import compiled
from seft_plant_sim.judge import detectors
from seft_plant_sim.judge.detectors import JUMP, WEAKENS, DetectorParameters, DetectorState, look
from seft_plant_sim.judge.judge_step import LIKE, OPPOSED

_SLIP, BREAK, _STIFFEST = 0.35, 0.25, 6.0
"""Largest change of a specimen's force in a step: parts of its largest force, with and against the
motion; with the motion, in addition, so many times the assumed stiffness."""

TURNED, TURN, MOVES = 3, 2.0, 0.2
"""Samples after a turn of the motion in which friction reverses, the change of the force by that,
and the part of the fastest recent motion above which a specimen does not stick."""


@compiled
def look_at_restoring_force(
    p: DetectorParameters, state: DetectorState, step: int, measured: Floats, i: int
) -> int:
    """Whether the specimen's force jumps, and it has neither hit a stop nor slipped like before."""
    n, last, r, rise, fall = measured.shape[1], state.last, state.restoring, 0.0, 0.0
    for k in range(n):
        spring = p.rig.stiffness[i, k] * (measured[0, k] - last[0, k])
        rise, fall = rise + max(spring, 0.0), fall + max(-spring, 0.0)
    change, moved = r[1, i] - r[0, i], abs(measured[0, i] - last[0, i])
    before, branch = state.changes[i, 0], state.judge.axes[i].alive[0]
    event, revised = branch.event, branch.restoring[1] - r[0, i]  # what was r then, as known now
    moves = p.still[i] + MOVES * state.judge.axes[i].travel
    slips = moved < moves or step - state.step[detectors.TURN_AT] <= TURNED
    largest = state.largest[3, i]
    if event[1] == 0.0:
        largest = max(abs(r[0, i]), p.memory * largest)
        state.largest[3, i] = largest
    # where its events have taken r
    jump = change if event[0] != 0.0 else 0.0
    if event[1] != 0.0:
        jump += before[0] + (revised if event[0] == 0.0 else 0.0)
    stiff = _STIFFEST * (rise if jump > 0.0 else fall)
    part = TURN if slips else (_SLIP if stiff > 0.0 else BREAK)
    threshold = part * largest + p.rough[i] + stiff
    is_stop = stiff > 0.0 and is_elastic(state.changes[i], change, moved, p.rough[i])
    is_like = slips and LIKE * state.judge.axes[i].known > abs(jump)
    sticks = slips and jump * measured[1, i] > 0.0  # it carries what it had not been asked for yet
    if event[1] != 0.0 and (is_stop or is_like or sticks):
        threshold = np.inf
    found = look(p, state, JUMP, i, abs(jump), threshold)
    if event[1] != 0.0 and state.counts[JUMP, i] == 1:  # it was known one sample late
        found = look(p, state, JUMP, i, abs(jump), threshold)
    return found


@compiled
def is_elastic(changes: Floats, change: float, moved: float, rough: float) -> bool:
    """Say whether a stop explains the last change of r: one beside it is as stiff, or half of that.

    A stop that is hit presses on, one that is left has pressed; what slips or breaks does so once.
    """
    jump, within = 0.5 * abs(changes[0, 0]), abs(changes[1, 0])
    presses = (abs(change) + rough) * within >= jump * moved
    return presses or (abs(changes[0, 1]) + rough) * within >= jump * abs(changes[1, 1])


@compiled
def look_at_work(p: DetectorParameters, state: DetectorState, measured: Floats) -> int:
    """Relation (4) of `detector_step`, over all axes."""
    n, last, r, work = measured.shape[1], state.last, state.restoring, state.work
    for row in range(3):
        work[row] *= p.short
    for i in range(n):
        moved, change = measured[0, i] - last[0, i], r[1, i] - r[0, i]
        noise = p.noise[3, i] ** 2
        for k in range(n):
            noise += (p.rig.mass[i, k] * p.noise[2, k]) ** 2
            work[1] += moved * p.rig.stiffness[i, k] * (measured[0, k] - last[0, k])
        work[0] += change * moved
        work[2] += 2.0 * (noise * moved * moved + (p.noise[0, i] * change) ** 2)
    threshold = OPPOSED * work[1] + 6.0 * math.sqrt(work[2]) + p.unknown
    return look(p, state, detectors.SECOND_ORDER_WORK, 0, -work[0], threshold)


@compiled
def look_at_strength(p: DetectorParameters, state: DetectorState, measured: Floats) -> int:
    """Whether the specimen has lost its force where it is deformed as far as never before.

    The deformation is measured by sqrt(x K x), the force by r x over that: of a specimen that is
    linear they are equal, in any mode. Both directions have a memory of their own.
    """
    n, x, farthest = measured.shape[1], measured[0], state.farthest
    energy = work = along = noise = 0.0
    for i in range(n):
        spring = 0.0
        for k in range(n):
            spring += p.rig.stiffness[i, k] * x[k]
        energy += x[i] * spring
        along += farthest[0, i] * spring
        work += x[i] * state.restoring[1, i]
        noise += (x[i] * p.rough[i]) ** 2
    side, row = 0 if along >= 0.0 else 1, WEAKENS
    if energy <= state.carried[side, 0]:
        look(p, state, row, 0, 0.0, 1.0)
        return -1
    root = math.sqrt(energy)
    carried = max(state.carried[side, 1], 0.0) * root
    found = look(p, state, row, 0, carried - work, OPPOSED * carried + math.sqrt(noise))
    if state.counts[row, 0] == 0:
        state.carried[side, 0], state.carried[side, 1] = energy, work / root
        for i in range(n):
            farthest[side, i] = x[i]
    return found
