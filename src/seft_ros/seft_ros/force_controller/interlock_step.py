"""Protection of the force control, step by step, compiled."""

from typing import NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats, Ints
from seft_plant_sim.compiled import compiled, is_finite
from seft_plant_sim.limits import is_exceeded
from seft_plant_sim.rig import left_open

from seft_ros.protection.detector_step import SOUND, SUSPECT, begin_detectors, detect, take_command
from seft_ros.protection.detectors import DetectorParameters, DetectorState
from seft_ros.protection.ramp_down import go_on

TRIP, STEP, SATURATED, DETECTED = range(4)
"""Places of the flags: reason and step of the trip, number of limited drives, and the detector that
has found a fault."""
NOTHING, IMPLAUSIBLE, ODD_DRIVE, SATURATION, FAULT, OUTSIDE = range(6)
"""Reasons of a trip; the last one is a reason from outside."""


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
    detectors : DetectorParameters
        Of faults.
    """

    largest: float
    window: int
    closing: float
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
        Reference force, sample and drive of the step of the trip, shapes (n,), (4, n) and (n,).
    drive : ndarray
        The last sound command, shape (n,), V.
    plan, sample : ndarray
        Points and sample for the controller, shapes (p, q, n) and (4, n).
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
def begin_interlock(state: InterlockState) -> None:
    """Begin a test."""
    state.flags[:] = 0
    state.drive[:] = 0.0
    begin_detectors(state.detectors)


@compiled
def begin_control(
    parameters: InterlockParameters,
    state: InterlockState,
    step: int,
    points: Floats,
    measured: Floats,
    command: Floats,
) -> bool:
    """Say whether the controller answers a step; otherwise give its command.

    The controller answers `InterlockState.plan` and `InterlockState.sample`. While a sample is
    suspect, these are the motion that the last sound target has predicted for this step; without a
    target, the last sound command is held. After a trip the valve closes from there, in some time:
    a valve that closes at once on a moving mass makes a pressure surge in the oil.

    Parameters
    ----------
    parameters, state
        The state is updated.
    step : int
        The step.
    points : ndarray
        Of the reference force, shape (p, q, n).
    measured : ndarray
        Displacement, velocity, acceleration and force, shape (4, n).
    command : ndarray
        Shape (n,), V.
    """
    last, n, left = points.shape[1] - 1, points.shape[2], 1.0
    if state.flags[TRIP] == NOTHING:
        # a target is compared with the motion, too
        fits = is_finite(measured, 0 if last else 3)
        for i in range(n):
            fits &= abs(points[0, last, i]) <= parameters.largest
        found = SOUND
        if fits and is_finite(measured, 0):  # without feedback, the motion need not be measured
            found = detect(parameters.detectors, state.detectors, step, points, measured)
        if fits and found == SOUND:
            take_plan(state, points, measured)
            return True
        if fits and found == SUSPECT and last:
            follow_plan(state, parameters.detectors.dt)
            return True
        if not fits or found >= 0:
            trip(state, FAULT if fits else IMPLAUSIBLE, step)
            state.flags[DETECTED] = found
            for i in range(n):
                state.force[i] = points[0, last, i]
                for row in range(4):
                    state.measured[row, i] = measured[row, i]
    if state.flags[TRIP] != NOTHING:
        left = left_open(step + 1 - state.flags[STEP], parameters.closing)
    for i in range(n):
        command[i] = left * state.drive[i]
    take_command(parameters.detectors, state.detectors, command, False)
    return False


@compiled
def take_plan(state: InterlockState, points: Floats, measured: Floats) -> None:
    """Let the controller answer a sample; store its points."""
    plan, sample, count = state.plan, state.sample, min(points.shape[0], state.plan.shape[0])
    alone = points.shape[1] < plan.shape[1]  # a force alone, while the nodes warm up
    for point in range(plan.shape[0]):
        sent = point if point < count else count - 1
        for row in range(plan.shape[1]):
            for i in range(plan.shape[2]):
                plan[point, row, i] = points[sent, 0 if alone else row, i]
    for row in range(4):
        for i in range(sample.shape[1]):
            sample[row, i] = measured[row, i]


@compiled
def follow_plan(state: InterlockState, dt: float) -> None:
    """Let the controller answer the motion that was predicted before samples were suspect."""
    plan, sample = state.plan, state.sample
    go_on(plan, 1, dt, plan)
    for i in range(sample.shape[1]):
        sample[0, i], sample[1, i] = plan[0, 0, i], plan[0, 1, i]
        sample[2, i] = (plan[min(1, len(plan) - 1), 1, i] - plan[0, 1, i]) / dt
        sample[3, i] = plan[0, 2, i]


@compiled
def end_control(
    parameters: InterlockParameters,
    state: InterlockState,
    step: int,
    limited: bool,
    command: Floats,
) -> None:
    """Check the command of a controller, and whether it is limited; trip if it is not finite."""
    for i in range(len(command)):
        if not np.isfinite(command[i]):
            trip(state, ODD_DRIVE, step)
    if limited and state.flags[TRIP] == NOTHING:
        if is_exceeded(state.saturated, state.flags[SATURATED], step, parameters.window):
            trip(state, SATURATION, step)
        state.flags[SATURATED] += 1
    for i in range(len(command)):
        if state.flags[TRIP] == NOTHING:
            state.drive[i] = command[i]
        else:
            state.odd[i] = command[i]
            command[i] = left_open(1, parameters.closing) * state.drive[i]
    take_command(parameters.detectors, state.detectors, command, limited)


@compiled
def trip(state: InterlockState, why: int, step: int) -> None:
    """Close the valve from now on."""
    state.flags[TRIP] = why
    state.flags[STEP] = step
