"""Relations of the measured channels of an axis, which hold for any specimen.

Over one sampling period, with displacement x, velocity v, acceleration a, actuator force f and the
valve's flow w::

    change of x = integral of v                                                            (1)
    change of v = integral of a                                                            (2)
    integral of w = integral of (v + lambda f / k_oil) + change of f / k_oil               (3)

Each side is summed with a memory of `MEMORY`, so that slow faults show, too. The mean of their
recent differences, which is the bias of a sensor, is subtracted.
"""

import math
from typing import NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_plant_sim.compiled import compiled

from seft_ros.protection.detectors import (
    ACCELERATION,
    CHANGE,
    DISPLACEMENT,
    DISPLACEMENT_VELOCITY,
    FOLLOWED_VALVES,
    FORCE_CHANNEL,
    LIMITED_AT,
    OIL,
    OIL_NOISE,
    SAMPLE,
    SIGMAS,
    VELOCITY,
    VELOCITY_ACCELERATION,
    DetectorParameters,
    DetectorState,
    first_of,
    look,
    sees,
)
from seft_ros.protection.valve_following import follow_valve, under_load

MISSED = 2.0
"""Commands in a row that the rig may miss without a sample beyond its threshold."""


@compiled
def take_command(
    p: DetectorParameters, state: DetectorState, command: Floats, limited: bool
) -> None:
    """Store the command that answers the last sample, (n,), V, and whether it is limited."""
    if limited and p.has_valve:
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


class Sides(NamedTuple):
    """The sides of a relation over one period, and what may make them differ."""

    one: float
    other: float
    least: float
    """Least and largest value of the first side if the rig holds a command."""
    largest: float
    in_sums: float
    """Difference that the times of the samples cause in the sums."""
    part: float
    """Relative error of the first side in a single step."""
    resolution: float
    """Of the first side."""
    missed: float
    """Difference that missed commands cause."""


@compiled
def hold(flows: Floats, newest: float) -> tuple[float, float]:
    """Store a flow; give the least and the largest of those that the rig may hold."""
    least = largest = newest
    for j in range(len(flows) - 1, 0, -1):
        flows[j] = flows[j - 1]
        least, largest = min(least, flows[j]), max(largest, flows[j])
    flows[0] = newest
    return least, largest


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
def resolution_of(state: DetectorState, row: int, i: int) -> float:
    """Resolution of a change of a channel; 0 as long as it is not known."""
    resolution = 2.0 * state.judge.resolution[row, i]
    return resolution if resolution < np.inf else 0.0


@compiled
def displacement_sides(
    p: DetectorParameters, state: DetectorState, measured: Floats, i: int
) -> Sides:
    """Relation (1)."""
    last = state.last
    one, other = measured[0, i] - last[0, i], 0.5 * p.dt * (measured[1, i] + last[1, i])
    late = p.late * abs(measured[1, i] - last[1, i])  # of a derived velocity
    return Sides(one, other, one, one, late, 0.0, resolution_of(state, 0, i), 0.0)


@compiled
def velocity_sides(p: DetectorParameters, state: DetectorState, measured: Floats, i: int) -> Sides:
    """Relation (2); a force may jump at any time between two samples.

    A held force jumps at each, and the motion between them may hide that in the acceleration.
    """
    last, rise, jump = state.last, measured[2, i] - state.last[2, i], 0.0
    for k in range(measured.shape[1]):
        jump += p.by_force[i, k] * (measured[3, k] - last[3, k])
    one, other = measured[1, i] - last[1, i], 0.5 * p.dt * (measured[2, i] + last[2, i])
    state.rise[0, i] = p.fade * state.rise[0, i] + rise
    state.rise[1, i] = p.fade * state.rise[1, i] + jump
    rises = max(abs(rise), abs(jump), abs(state.rise[0, i]), abs(state.rise[1, i]))
    late = (0.5 * p.dt + p.late) * rises
    return Sides(one, other, one, one, late, 0.0, resolution_of(state, 1, i), 0.0)


@compiled
def oil_sides(p: DetectorParameters, state: DetectorState, measured: Floats, i: int) -> Sides:
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
    if state.counts[OIL_NOISE, i] == 0 and state.counts[CHANGE + OIL, i] == 0:
        follow_valve(errors, covariance, flow, later, other / dt, p.doubt[i])
    part = min(p.tolerance[OIL], FOLLOWED_VALVES + SIGMAS * math.sqrt(covariance[0]))
    change = abs(state.flow[1, i] - state.flow[0, i])
    state.largest[8, i] = max(change, p.fade * state.largest[8, i])
    missed = MISSED * dt * state.largest[8, i]
    resolution = resolution_of(state, FORCE_CHANNEL, i) / oil
    return Sides(one, other, least, largest, 0.0, part, resolution, missed)


@compiled
def compare_channels(
    p: DetectorParameters, state: DetectorState, relation: int, n: int, i: int, sides: Sides
) -> int:
    """Compare the sums of the sides of a relation, less their bias; of (3) also single steps."""
    recent, bias, found = state.largest, state.bias[relation], -1
    one, other, is_oil = sides.one, sides.other + bias[0, i], relation == OIL
    if state.counts[CHANGE + relation, i] == 0 and not (is_oil and state.counts[OIL_NOISE, i]):
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
    threshold = p.steps[i] + sides.part * single + known
    if is_oil and look_at_sides(p, state, OIL_NOISE, i, now, threshold, missed) and found < 0:
        found = OIL_NOISE * n + i
    return found


@compiled
def relations(
    p: DetectorParameters, state: DetectorState, step: int, measured: Floats, i: int
) -> int:
    """Relations (1) to (3) of an axis."""
    n, found = measured.shape[1], -1
    sees_velocity = sees(state, step, VELOCITY)
    if sees_velocity and sees(state, step, DISPLACEMENT):
        sides = displacement_sides(p, state, measured, i)
        found = compare_channels(p, state, DISPLACEMENT_VELOCITY, n, i, sides)
    if sees_velocity and sees(state, step, ACCELERATION):
        sides = velocity_sides(p, state, measured, i)
        found = first_of(found, compare_channels(p, state, VELOCITY_ACCELERATION, n, i, sides))
    if sees_velocity and sees(state, step, FORCE_CHANNEL):
        sides = oil_sides(p, state, measured, i)
        found = first_of(found, compare_channels(p, state, OIL, n, i, sides))
    return found
