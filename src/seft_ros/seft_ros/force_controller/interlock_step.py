"""Steps of the interlock: what a sample, a reference force and a command may be."""

from typing import NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats, Ints
from seft_plant_sim.compiled import compiled, copy
from seft_plant_sim.judge.detector_step import judge_sample, look_at_tracking
from seft_plant_sim.judge.detectors import (
    SUSPECT,
    VALID,
    DetectorParameters,
    DetectorState,
    first_of,
)
from seft_plant_sim.limits import is_exceeded
from seft_plant_sim.simulated.rig import left_open

from seft_ros.protection.protection_step import as_sample, extrapolate

TRIP, STEP, SATURATED, DETECTED = range(4)
"""Places of the flags: reason and step of the trip, number of limited drives, and the detector that
has found a fault."""
NO_TRIP, IMPLAUSIBLE, IMPLAUSIBLE_COMMAND, SATURATION, FAULT, LIMIT, OUTSIDE = range(7)
"""Reasons of a trip; the last one is a reason from outside."""
VALID_CAUSES = NO_TRIP, IMPLAUSIBLE, LIMIT
"""With these, sensors, valves and controller are fault-free, so that a stop can follow the plan."""


class InterlockParameters(NamedTuple):
    """Parameters of an interlock.

    Attributes
    ----------
    largest : float
        Magnitude of the reference force beyond which it is implausible, N.
    window : int
        Steps of a second.
    closing : float
        Steps in which the valve closes after a trip.
    has_stop : bool
        Whether the controller can stop along its plan.
    limits : ndarray
        Largest judged displacement, velocity, acceleration and force, shape (4,).
    detectors : DetectorParameters
        Of faults.
    """

    largest: float
    window: int
    closing: float
    has_stop: bool
    limits: Floats
    detectors: DetectorParameters


class InterlockState(NamedTuple):
    """State of an interlock.

    Attributes
    ----------
    flags : ndarray
        See `TRIP`, shape (4,).
    saturated : ndarray
        The last steps at which the drive was limited, see `is_exceeded`.
    force, measured, odd : ndarray
        Reference force, judged sample and drive of the step of the trip, shapes (n,), (4, n) and
        (n,).
    drive : ndarray
        The last fault-free command, shape (n,), V.
    plan : ndarray
        Points for the controller, shape (p, q, n).
    sample : ndarray
        Sample for the controller, shape (4, n).
    detectors : DetectorState
        Of faults.
    """

    flags: Ints
    saturated: Ints
    force: Floats
    measured: Floats
    odd: Floats
    drive: Floats
    plan: Floats
    sample: Floats
    detectors: DetectorState


@compiled
def take_sample(
    parameters: InterlockParameters,
    state: InterlockState,
    step: int,
    raw: Floats,
    judged: Floats,
) -> None:
    """Judge a sample, see `judge_sample`; trip at a fault, or beyond a limit."""
    found = judge_sample(parameters.detectors, state.detectors, step, raw, judged)
    beyond = False
    for row in range(4):
        for i in range(judged.shape[1]):
            beyond |= abs(judged[row, i]) > parameters.limits[row]
    if state.flags[TRIP] == NO_TRIP:
        state.flags[DETECTED] = found
        if beyond or found >= 0:
            trip(state, LIMIT if beyond else FAULT, step)
            for row in range(4):
                copy(judged.shape[1], judged[row], state.measured[row])


@compiled
def precheck(
    parameters: InterlockParameters,
    state: InterlockState,
    step: int,
    points: Floats,
    judged: Floats,
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
    judged : ndarray
        The step's judged sample, see `take_sample`; shape (4, n).
    command : ndarray
        Shape (n,), V.
    """
    last, n = points.shape[1] - 1, points.shape[2]
    if state.flags[TRIP] == NO_TRIP:
        fits, found = True, state.flags[DETECTED]
        for i in range(n):
            force = points[0, last, i]
            fits &= abs(force) <= parameters.largest
        for i in range(n):
            if fits and state.plan.shape[1] > 1:  # a controller of forces reads them alone
                detectors = parameters.detectors
                away = look_at_tracking(detectors, state.detectors, step, points, judged, i)
                found = first_of(found, away)
        if fits and found == VALID:
            take_plan(state, points, judged)
            return True
        if fits and found == SUSPECT and last and state.plan.shape[1] > 1:
            follow_plan(state, parameters.detectors.dt)
            return True
        if not fits or found >= 0:
            trip(state, FAULT if fits else IMPLAUSIBLE, step)
            state.flags[DETECTED] = found
            copy(n, points[0, last], state.force)
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
    """Check the command of a controller, and whether it is limited; trip if it is not finite."""
    for i in range(len(command)):
        if not np.isfinite(command[i]):
            trip(state, IMPLAUSIBLE_COMMAND, step)
    if limited and parameters.detectors.has_valve and state.flags[TRIP] == NO_TRIP:
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
