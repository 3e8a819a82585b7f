"""Steps of the interlock: what a reference force and a command may be."""

from typing import NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats, Ints
from seft_plant_sim.compiled import compiled, copy
from seft_plant_sim.judge.guard import SUSPECT_ROW
from seft_plant_sim.limits import is_exceeded
from seft_plant_sim.simulated.rig_step import left_open

from seft_ros.force_controller.target_distance import (
    TrackingParameters,
    TrackingState,
    off_target,
)
from seft_ros.protection.protection_step import as_sample, extrapolate

TRIP, STEP, SATURATED, AXIS = range(4)
"""Places of the flags: reason and step of the trip, number of limited drives, and the axis that is
away from its target."""
NO_TRIP, IMPLAUSIBLE, IMPLAUSIBLE_COMMAND, SATURATION, OFF_TARGET, LIMIT, OUTSIDE = range(7)
"""Reasons of a trip; the last one is a reason from outside."""
VALID_CAUSES = NO_TRIP, IMPLAUSIBLE, LIMIT
"""With these, valves and controller are fault-free, so that a stop can follow the plan."""


class InterlockParameters(NamedTuple):
    """Parameters of an interlock.

    Attributes
    ----------
    largest : float
        Magnitude of the reference force beyond which it is implausible, N.
    window : int
        Steps of a second.
    closing : float
        Steps in which the valve closes after a trip; infinite: the last command is held.
    has_stop : bool
        Whether the controller can stop along its plan.
    limits : ndarray
        Largest displacement, velocity, acceleration and force of a sample, shape (4,).
    has_valve : bool
        Whether its commands drive the rig.
    dt : float
        Sampling period, s.
    fastest : float
        Largest change of a command in a step.
    tracking : TrackingParameters
        Of the distance to the target.
    """

    largest: float
    window: int
    closing: float
    has_stop: bool
    limits: Floats
    has_valve: bool
    dt: float
    fastest: float
    tracking: TrackingParameters


class InterlockState(NamedTuple):
    """State of an interlock.

    Attributes
    ----------
    flags : ndarray
        See `TRIP`, shape (4,).
    saturated : ndarray
        The last steps at which the drive was limited, see `is_exceeded`.
    force, measured, odd : ndarray
        Reference force, sample and drive of the step of the trip, shapes (n,), (4, n) and (n,).
    drive : ndarray
        The last fault-free command, shape (n,), V.
    plan : ndarray
        Points for the controller, shape (p, q, n).
    sample : ndarray
        Sample for the controller, shape (4, n).
    tracking : TrackingState
        Of the distance to the target.
    """

    flags: Ints
    saturated: Ints
    force: Floats
    measured: Floats
    odd: Floats
    drive: Floats
    plan: Floats
    sample: Floats
    tracking: TrackingState


@compiled
def check_limits(
    parameters: InterlockParameters, state: InterlockState, step: int, measured: Floats
) -> None:
    """Trip if a judged sample is beyond a limit: then the stop follows the plan."""
    if state.flags[TRIP] == NO_TRIP:
        for row in range(4):
            for i in range(measured.shape[1]):
                if abs(measured[row, i]) > parameters.limits[row]:
                    trip(state, LIMIT, step)
            copy(measured.shape[1], measured[row], state.measured[row])


@compiled
def precheck(
    parameters: InterlockParameters,
    state: InterlockState,
    step: int,
    points: Floats,
    measured: Floats,
    command: Floats,
) -> bool:
    """Say whether the controller answers a step; otherwise give its command.

    The controller answers `InterlockState.plan` and `InterlockState.sample`. While a sample is
    suspect, these are the motion that the last fault-free target has predicted for this step;
    without a target, the last fault-free command is held. At a trip the stop begins, see
    `Interlock.stop`.

    Parameters
    ----------
    parameters, state
        The state is updated.
    step : int
        The step.
    points : ndarray
        Of the reference force, shape (p, q, n).
    measured : ndarray
        The step's sample of rig/state, shape (6, n).
    command : ndarray
        Shape (n,), V.
    """
    last, n = points.shape[1] - 1, points.shape[2]
    if state.flags[TRIP] == NO_TRIP:
        fits, has_target, away = True, state.plan.shape[1] > 1 and last > 0, -1
        for i in range(n):
            fits &= abs(points[0, last, i]) <= parameters.largest
        if fits and has_target:  # a controller of forces reads them alone
            target = points[0, 0]
            away = off_target(parameters.tracking, state.tracking, step, target, measured)
        if not fits or away >= 0:
            trip(state, OFF_TARGET if fits else IMPLAUSIBLE, step)
            state.flags[AXIS] = away
            copy(n, points[0, last], state.force)
        elif measured[SUSPECT_ROW, 0] == 0.0:
            take_plan(state, points, measured)
            return True
        elif has_target:
            follow_plan(state, parameters.dt)
            return True
    begin_stop(parameters, state, command)
    return False


@compiled
def take_plan(state: InterlockState, points: Floats, measured: Floats) -> None:
    """Let the controller answer a sample; store of its points what it follows.

    The force is the last row. It is alone while the nodes warm up; a controller of forces follows
    it alone also where there is a target.
    """
    count, quantities, n = state.plan.shape
    first = points.shape[1] - quantities
    for point in range(count):
        sent = points[min(point, len(points) - 1)]
        for row in range(quantities):
            copy(n, sent[max(0, first + row)], state.plan[point, row])
    for row in range(4):
        copy(n, measured[row], state.sample[row])


@compiled
def follow_plan(state: InterlockState, dt: float) -> None:
    """Let the controller answer the motion that was predicted before samples were suspect."""
    extrapolate(state.plan, 1, dt, state.plan)
    as_sample(state.plan, dt, state.sample)


@compiled
def postcheck(
    parameters: InterlockParameters,
    state: InterlockState,
    step: int,
    limited: bool,
    command: Floats,
) -> None:
    """Check the command of a controller, and whether it is limited; trip if it is not finite.

    So it does if the command of a displacement servo jumps.
    """
    for i in range(len(command)):
        change = abs(command[i] - state.drive[i]) if step > 0 else 0.0
        if not np.isfinite(command[i]) or change > parameters.fastest:
            trip(state, IMPLAUSIBLE_COMMAND, step)
    if limited and parameters.has_valve and state.flags[TRIP] == NO_TRIP:
        if is_exceeded(state.saturated, state.flags[SATURATED], step, parameters.window):
            trip(state, SATURATION, step)
        state.flags[SATURATED] += 1
    if state.flags[TRIP] == NO_TRIP:
        copy(len(command), command, state.drive)
    else:
        copy(len(command), command, state.odd)
        begin_stop(parameters, state, command)


@compiled
def begin_stop(parameters: InterlockParameters, state: InterlockState, command: Floats) -> None:
    """Give the command of the step of a trip; without a trip, hold the last one."""
    why, left = state.flags[TRIP], 1.0
    if why != NO_TRIP and not (parameters.has_stop and why in VALID_CAUSES):
        left = left_open(1, parameters.closing)
    for i in range(len(command)):
        command[i] = left * state.drive[i]


@compiled
def trip(state: InterlockState, why: int, step: int) -> None:
    """Stop from now on."""
    state.flags[TRIP] = why
    state.flags[STEP] = step
