"""Relations of the measured channels of an axis, which hold for any specimen.

Over one sampling period, with displacement x, velocity v, acceleration a, actuator force f and the
valve's flow w::

    change of x = integral of v                                                            (1)
    change of v = integral of a                                                            (2)
    integral of w = change of (x + f / k_oil) + integral of lambda f / k_oil               (3)

Each side is summed with a memory of 50 ms, the last ones of 0.2 s, so that slow faults show, too.
Gain, delay and bias of the right side (in (3) those of the valve) are followed, see
`relation_following`.
"""

import math

import numpy as np
from seft_msgs_py.arrays import Floats

from seft_plant_sim.channels import ACCELERATION, DISPLACEMENT, FORCE, VELOCITY
from seft_plant_sim.compiled import compiled, dot, put_first
from seft_plant_sim.judge import detectors
from seft_plant_sim.judge import relation_following as following
from seft_plant_sim.judge.detectors import OIL, DetectorParameters, DetectorState, first_of, sees
from seft_plant_sim.judge.judge_step import is_replaced
from seft_plant_sim.judge.known_rig import CAPACITY, FLOW_GAIN, LEAKAGE, OIL_STIFFNESS
from seft_plant_sim.judge.relation_following import BIAS_OF, CHANGE, INTEGRAL, NOISE_SIGMAS, PERIODS
from seft_plant_sim.judge.valve_following import under_load

Sides = tuple[float, float, float]
"""Change of one side in a period, integral of the other, and its change per delay."""


@compiled
def find_flow(p: DetectorParameters, state: DetectorState, lost: int, drive: Floats) -> None:
    """Find the mean flow of each valve without load since the last sample.

    Before the present drive, of shape (n,), the rig has held the last if samples were lost.
    """
    for i in range(len(drive)):
        for _ in range(min(lost, state.sent.shape[1])):
            put_first(state.sent[i], state.sent[i, 0])
        put_first(state.sent[i], drive[i])
        for k in range(2):
            flow = dot(state.sent.shape[1], p.rig.past[i, k], state.sent[i])
            state.flow[k, i] = p.rig.actuator[i, FLOW_GAIN] * flow


def begin_relations(p: DetectorParameters, state: DetectorState) -> None:
    """Begin a test with what is assumed."""
    state.scatter[:, following.SCATTER] = (detectors.UNDESCRIBED[:, np.newaxis] / NOISE_SIGMAS) ** 2
    state.scatter[:, following.WEIGHT] = 1.0
    for row in range(3):
        state.covariance[:, :, row, row] = p.deviation[:, row] ** 2


@compiled
def resolution_of(state: DetectorState, row: int, i: int) -> float:
    """Resolution of a change of a channel; 0 as long as it is not known."""
    resolution = 2.0 * state.judge.resolution[row, i]
    return resolution if resolution < np.inf else 0.0


@compiled
def compare_channels(
    p: DetectorParameters, state: DetectorState, relation: int, i: int, sides: Sides, rough: float
) -> int:
    """Compare the sums of the sides of a relation.

    Parameters
    ----------
    p, state
        The state is updated.
    relation, i : int
        Place of the relation, and of the axis.
    sides : Sides
        Of the last period.
    rough : float
        Difference of the sums by what came between the samples, and by the converter.
    """
    sums, found, scatter = state.sums[relation], state.estimated[relation], state.scatter[relation]
    covariance, row = state.covariance[relation, i], detectors.DIFFERS + relation
    fade = p.oil_fade if relation == OIL else p.fade
    change, integral, per_delay = sides
    now = (change, integral, per_delay, p.rig.dt)
    for place in range(4):
        sums[place, i] = fade * sums[place, i] + now[place]
    summed = sums[INTEGRAL, i], sums[following.PER_DELAY, i], sums[PERIODS, i]
    off = sums[CHANGE, i] - following.expected(found, i, *summed)
    whole = max(abs(sums[CHANGE, i]), abs(sums[INTEGRAL, i]), p.memory * state.largest[relation, i])
    state.largest[relation, i] = whole
    noise = p.sums[relation, i]
    by_estimates = following.uncertain(covariance, *summed)
    left = max(scatter[following.SCATTER, i], 0.0) * whole * whole
    known = math.sqrt(noise * noise + NOISE_SIGMAS * NOISE_SIGMAS * (by_estimates + left))
    bias = NOISE_SIGMAS * math.sqrt(max(covariance[BIAS_OF, BIAS_OF], 0.0))
    bias = min(bias, p.deviation[relation, BIAS_OF, i]) * sums[PERIODS, i]
    most = noise + bias + detectors.TOLERANCES[relation] * whole
    if relation == OIL and p.rig.imposes:  # its valve may yet saturate, or the specimen stop it
        known = most
    threshold = min(known, most) + rough
    fault = detectors.look(p, state, row, i, abs(off), threshold)
    if state.counts[row, i] == 0:
        persistent = p.correlated[relation] * ((rough / NOISE_SIGMAS) ** 2 + left)
        white = 1.0 if relation == OIL else p.correlated[relation]  # the noise of a displacement is
        doubt = white * (noise / NOISE_SIGMAS) ** 2 + persistent
        moves = whole > following.MOTION_TO_NOISE / NOISE_SIGMAS * (noise + rough)
        limits, drift = p.most[relation], p.drift[relation]
        following.follow(found, covariance, sums, limits, drift, i, off, doubt, moves)
        usual, by_noise = known / NOISE_SIGMAS, noise / NOISE_SIGMAS
        following.remember(scatter, i, off, usual, whole, by_noise, p.rig.dt)
    return fault


@compiled
def displacement_velocity(
    p: DetectorParameters, state: DetectorState, measured: Floats, i: int
) -> int:
    """Relation (1); the acceleration tells how the velocity bends between the samples."""
    last, change = state.last, measured[1, i] - state.last[1, i]
    bend = p.rig.dt / 6.0 * (measured[2, i] - last[2, i])
    moved = 0.5 * p.rig.dt * (measured[1, i] + last[1, i] - bend)
    rough = p.late * abs(change) + resolution_of(state, DISPLACEMENT, i)
    sides = (measured[0, i] - last[0, i], moved, -change)
    return compare_channels(p, state, detectors.DISPLACEMENT_VELOCITY, i, sides, rough)


@compiled
def velocity_acceleration(
    p: DetectorParameters, state: DetectorState, measured: Floats, i: int
) -> int:
    """Relation (2); a force may jump at any time between two samples.

    A held force jumps at each, and the motion between them may hide that in the acceleration.
    """
    last, rise, jump = state.last, measured[2, i] - state.last[2, i], 0.0
    for k in range(measured.shape[1]):
        jump += p.by_force[i, k] * (measured[3, k] - last[3, k])
    bend = abs(rise - state.rise[0, i])
    state.rise[0, i] = rise
    state.rise[1, i] = max(bend, p.fade * state.rise[1, i])
    state.rise[2, i] = p.fade * state.rise[2, i] + jump
    rises = max(state.rise[1, i], abs(jump), abs(state.rise[2, i]))
    rough = (0.5 * p.rig.dt + p.late) * rises + resolution_of(state, VELOCITY, i)
    gained = 0.5 * p.rig.dt * (measured[2, i] + last[2, i])
    sides = (measured[1, i] - last[1, i], gained, -rise)
    return compare_channels(p, state, detectors.VELOCITY_ACCELERATION, i, sides, rough)


@compiled
def oil_balance(p: DetectorParameters, state: DetectorState, measured: Floats, i: int) -> int:
    """Relation (3)."""
    last, oil = state.last, p.rig.actuator[i, OIL_STIFFNESS]
    force = 0.5 * (measured[3, i] + last[3, i])
    load = p.rig.dt * under_load(state.flow[0, i], force, p.rig.actuator[i, CAPACITY])
    flow, later = load * state.flow[0, i], load * state.flow[1, i]
    leaked = p.rig.dt * p.rig.actuator[i, LEAKAGE] * force
    change = measured[0, i] - last[0, i] + (measured[3, i] - last[3, i] + leaked) / oil
    rough = resolution_of(state, FORCE, i) / oil + resolution_of(state, DISPLACEMENT, i)
    return compare_channels(p, state, OIL, i, (change, flow, later), rough)


@compiled
def relations(
    p: DetectorParameters, state: DetectorState, step: int, measured: Floats, i: int
) -> int:
    """Relations (1) to (3) of an axis; (1) would not forget a velocity that is only expected."""
    found, sees_displacement = -1, sees(state, step, DISPLACEMENT)
    if not sees(state, step, VELOCITY):
        return found
    was = is_replaced(state.judge, 0, VELOCITY, i) or is_replaced(state.judge, 1, VELOCITY, i)
    if sees_displacement and not was:
        found = displacement_velocity(p, state, measured, i)
    if sees(state, step, ACCELERATION):
        found = first_of(found, velocity_acceleration(p, state, measured, i))
    if sees_displacement and sees(state, step, FORCE):
        found = first_of(found, oil_balance(p, state, measured, i))
    return found
