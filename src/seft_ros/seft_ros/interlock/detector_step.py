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
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from seft_plant_sim.compiled import compiled

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

DISPLACEMENT_VELOCITY, VELOCITY_ACCELERATION, OIL = range(3)
"""Relations (1) to (3)."""
CHANGE, NOISE, ROUGH, SECOND_ORDER_WORK, NO_RESPONSE, TRACKING, FROZEN = 0, 3, 6, 7, 8, 9, 10
"""Rows of the detectors: a relation's sums, its single steps, and so on; of frozen channels four."""
DETECTORS = 14
LEAST_PRESSURE = 0.2
"""Part of the supply pressure that is always reckoned to be left for the flow."""
OPPOSED = 0.5
"""Part of the stiffness as told by which a specimen may soften: fracture, buckling."""
SILENT = 25.0
"""Mean square of the change of the computed mass's force over that of the noise, from which on a
force that is but noise does not answer."""
SAME = 1e-9
"""Chance of as many equal samples of a channel that is not frozen."""


class DetectorParameters(NamedTuple):
    """What does not change of the detectors of n axes.

    Attributes
    ----------
    dt : float
        Sampling period, s.
    fade, short, memory : float
        Factors per step with which sums, short sums and the largest motion fade.
    actuator : ndarray
        Flow gain, oil stiffness, leakage and force capacity, see `FeedforwardParameters`; (n, 4).
    past : ndarray
        Part of past commands in the flow now, the newest first, shape (n, m).
    mass, stiffness : ndarray
        Of the specimen as told, shape (n, n), kg and N/m.
    computed_mass : ndarray
        M_c on the axes, shape (n, n), kg.
    noise : ndarray
        RMS noise of the sensors, shape (4, n).
    sums, steps : ndarray
        Noise of the differences of relations (1) to (3), `SIGMAS` times RMS: of sums and of a
        single step, shape (3, n); infinite where a relation is not watched.
    rough : ndarray
        Likewise of the second difference of r, shape (n,), N.
    unknown : float
        0; infinite where the specimen is not known.
    tolerance : ndarray
        Part of the largest motion by which the sides of a relation may differ, shape (3,).
    off_target : float
        Part of the target's largest motion by which the specimen may be away from it; infinite
        where there is no target.
    persistence : ndarray
        Samples for which a detector must be beyond its threshold, shape (D,).
    acts : ndarray
        Whether a detector ends the test, shape (D,); 0: it only warns.
    """

    dt: float
    fade: float
    short: float
    memory: float
    actuator: Floats
    past: Floats
    mass: Floats
    stiffness: Floats
    computed_mass: Floats
    noise: Floats
    sums: Floats
    steps: Floats
    rough: Floats
    unknown: float
    tolerance: Floats
    off_target: float
    persistence: Ints
    acts: Ints


class DetectorState(NamedTuple):
    """What changes of them.

    Attributes
    ----------
    last : ndarray
        The last sample, shape (4, n).
    flow : ndarray
        Flow of the valve at the last sample, shape (n,), m/s.
    sent : ndarray
        Past commands as they act under load, the newest first, shape (n, m), V.
    sums : ndarray
        Both sides of relations (1) to (3), shape (3, 2, n).
    largest : ndarray
        Largest of these of late, of a single step, and of the target's motion; shape (7, n).
    restoring : ndarray
        r at the last sample, its last change, and room for this one; shape (3, n), N.
    work : ndarray
        Sums of dr dx, of dx K dx and of squares of its noise, shape (3,).
    response : ndarray
        Sums of squares of the changes of f and of M_c a, shape (2, n), N^2.
    repeats : ndarray
        How often the last value of a channel has come, shape (4, n).
    resolution : ndarray
        Least change of a channel that was ever seen, shape (4, n); infinite before.
    counts : ndarray
        Samples for which each detector has been beyond its threshold, shape (D, n).
    shares : ndarray
        Largest part of its threshold that each has reached, shape (D, n).
    found : ndarray
        What a detector saw when it tripped, and its threshold; shape (2,).
    step : ndarray
        Step of the last sample, shape (1,); before the first -2.
    """

    last: Floats
    flow: Floats
    sent: Floats
    sums: Floats
    largest: Floats
    restoring: Floats
    work: Floats
    response: Floats
    repeats: Ints
    resolution: Floats
    counts: Ints
    shares: Floats
    found: Floats
    step: Ints


@compiled
def begin_detectors(state: DetectorState) -> None:
    """Begin a test."""
    state.sent[:] = 0.0
    state.flow[:] = 0.0
    state.sums[:] = 0.0
    state.largest[:] = 0.0
    state.restoring[:] = 0.0
    state.work[:] = 0.0
    state.response[:] = 0.0
    state.repeats[:] = 0
    state.resolution[:] = np.inf
    state.counts[:] = 0
    state.shares[:] = 0.0
    state.step[0] = -2


@compiled
def under_load(direction: float, force: float, capacity: float) -> float:
    """Flow of a valve that opens in a direction, over that without load (Merritt 1967)."""
    left = 1.0 - force / capacity if direction > 0.0 else 1.0 + force / capacity
    return math.sqrt(max(left, LEAST_PRESSURE))


@compiled
def take_command(p: DetectorParameters, state: DetectorState, command: Floats) -> None:
    """Remember the command that answers the last sample, shape (n,), V."""
    for i in range(len(command)):
        for j in range(state.sent.shape[1] - 1, 0, -1):
            state.sent[i, j] = state.sent[i, j - 1]
        load = under_load(command[i], state.last[3, i], p.actuator[i, 3])
        state.sent[i, 0] = command[i] * load


@compiled
def look(
    p: DetectorParameters, state: DetectorState, row: int, i: int, seen: float, threshold: float
) -> bool:
    """Hold what a detector sees against its threshold; say whether it has persisted and acts."""
    share = seen / threshold if threshold > 0.0 else 0.0
    if share > state.shares[row, i]:
        state.shares[row, i] = share
    count = state.counts[row, i]
    state.counts[row, i] = count = count + 1 if share > 1.0 else max(count - 1, 0)
    if count >= p.persistence[row] and p.acts[row]:
        state.found[0], state.found[1] = seen, threshold
        return True
    return False


@compiled
def detect(
    p: DetectorParameters, state: DetectorState, step: int, points: Floats, measured: Floats
) -> int:
    """Take a sample in; say which detector ends the test, row * n + axis, or -1.

    Parameters
    ----------
    p, state
        The state is brought up to date.
    step : int
        Of the sample. Where that of the step before is missing, nothing is compared.
    points : ndarray
        Of the reference force, shape (h + 1, q, n); q is 3 where it is of a target.
    measured : ndarray
        Displacement, velocity, acceleration and force, finite, shape (4, n).
    """
    n, found, is_first = measured.shape[1], -1, state.step[0] != step - 1
    state.step[0] = step
    last, restoring = state.last, state.restoring
    for i in range(n):
        total = measured[3, i]
        for k in range(n):
            total -= p.mass[i, k] * measured[2, k]
        restoring[2, i] = total
    if not is_first:
        for i in range(n):
            for at in (_relations(p, state, measured, i), _channels(p, state, measured, i)):
                found = at if found < 0 else found
            if points.shape[1] > 1:
                away = abs(points[0, 0, i] - measured[0, i])
                largest = max(abs(points[0, 0, i]), abs(measured[0, i]))
                largest = max(largest, p.memory * state.largest[6, i])
                state.largest[6, i] = largest
                threshold = p.sums[DISPLACEMENT_VELOCITY, i] + p.off_target * largest
                if look(p, state, TRACKING, i, away, threshold) and found < 0:
                    found = TRACKING * n + i
        at = _specimen(p, state, measured)
        found = at if found < 0 else found
    for i in range(n):
        restoring[1, i] = 0.0 if is_first else restoring[2, i] - restoring[0, i]
        restoring[0, i] = restoring[2, i]
        for row in range(4):
            last[row, i] = measured[row, i]
    return found


@compiled
def _relations(p: DetectorParameters, state: DetectorState, measured: Floats, i: int) -> int:
    """Relations (1) to (3) of an axis."""
    n, dt, last, found = measured.shape[1], p.dt, state.last, -1
    gain, oil, leakage = p.actuator[i, 0], p.actuator[i, 1], p.actuator[i, 2]
    flow = 0.0
    for j in range(state.sent.shape[1]):
        flow += p.past[i, j] * state.sent[i, j]
    flow *= gain
    moved = 0.5 * dt * (measured[1, i] + last[1, i])
    for relation in range(3):
        if relation == DISPLACEMENT_VELOCITY:
            one, other = measured[0, i] - last[0, i], moved
        elif relation == VELOCITY_ACCELERATION:
            one = measured[1, i] - last[1, i]
            other = 0.5 * dt * (measured[2, i] + last[2, i])
        else:
            one = 0.5 * dt * (flow + state.flow[i])
            other = 0.5 * dt * leakage * (measured[3, i] + last[3, i])
            other = moved + (measured[3, i] - last[3, i] + other) / oil
        sums, largest = state.sums[relation], state.largest
        sums[0, i] = p.fade * sums[0, i] + one
        sums[1, i] = p.fade * sums[1, i] + other
        whole = max(abs(sums[0, i]), abs(sums[1, i]), p.memory * largest[relation, i])
        step = max(abs(one), abs(other), p.memory * largest[3 + relation, i])
        largest[relation, i], largest[3 + relation, i] = whole, step
        tolerance = p.tolerance[relation]
        off, threshold = abs(sums[0, i] - sums[1, i]), p.sums[relation, i] + tolerance * whole
        if look(p, state, CHANGE + relation, i, off, threshold) and found < 0:
            found = (CHANGE + relation) * n + i
        off, threshold = abs(one - other), p.steps[relation, i] + tolerance * step
        if look(p, state, NOISE + relation, i, off, threshold) and found < 0:
            found = (NOISE + relation) * n + i
    state.flow[i] = flow
    return found


@compiled
def _channels(p: DetectorParameters, state: DetectorState, measured: Floats, i: int) -> int:
    """Whether a channel of an axis repeats one value."""
    n, found = measured.shape[1], -1
    for row in range(4):
        change = abs(measured[row, i] - state.last[row, i])
        if change > 0.0:
            state.repeats[row, i] = 0
            if change < state.resolution[row, i]:
                state.resolution[row, i] = change
        else:
            state.repeats[row, i] += 1
        # the chance of the same value twice is its step over 2 sqrt(pi) times the noise
        chance = state.resolution[row, i] / (2.0 * math.sqrt(math.pi) * p.noise[row, i])
        threshold = math.log(SAME) / math.log(chance) if chance < 0.5 else np.inf
        seen = float(state.repeats[row, i])
        if look(p, state, FROZEN + row, i, seen, threshold) and found < 0:
            found = (FROZEN + row) * n + i
    return found


@compiled
def _specimen(p: DetectorParameters, state: DetectorState, measured: Floats) -> int:
    """Relation (4), and whether each force answers the motion, and does so smoothly."""
    n, found, last, r = measured.shape[1], -1, state.last, state.restoring
    done = elastic = doubt = 0.0
    for i in range(n):
        moved, change = measured[0, i] - last[0, i], r[2, i] - r[0, i]
        done += change * moved
        inertia = noise = curvature = 0.0
        for k in range(n):
            elastic += moved * p.stiffness[i, k] * (measured[0, k] - last[0, k])
            curvature += p.stiffness[i, k] * p.dt * p.dt * (measured[2, k] + last[2, k])
            inertia += p.computed_mass[i, k] * (measured[2, k] - last[2, k])
            noise += (p.mass[i, k] * p.noise[2, k]) ** 2
        noise = 2.0 * (noise + p.noise[3, i] ** 2)
        doubt += noise * moved * moved
        threshold = p.rough[i] + abs(curvature)
        if look(p, state, ROUGH, i, abs(change - r[1, i]), threshold) and found < 0:
            found = ROUGH * n + i
        response, change = state.response, measured[3, i] - last[3, i]
        response[0, i] = p.short * response[0, i] + change * change
        response[1, i] = p.short * response[1, i] + inertia * inertia
        # a force that is noise, while the computed mass alone asks for far more
        white = 2.0 * p.noise[3, i] ** 2 / (1.0 - p.short)
        threshold = SILENT * white if response[0, i] < 2.0 * white else np.inf
        if look(p, state, NO_RESPONSE, i, response[1, i], threshold) and found < 0:
            found = NO_RESPONSE * n + i
    work = state.work
    work[0] = p.short * work[0] + done
    work[1] = p.short * work[1] + elastic
    work[2] = p.short * work[2] + doubt
    threshold = OPPOSED * work[1] + 6.0 * math.sqrt(work[2]) + p.unknown
    if look(p, state, SECOND_ORDER_WORK, 0, -work[0], threshold) and found < 0:
        found = SECOND_ORDER_WORK * n
    return found
