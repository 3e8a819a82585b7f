"""How the force control is protected, step by step, compiled."""

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
"""Places of the flags: why it has tripped, at which step, how often the drive was limited, and
which detector has found a fault."""
NOTHING, NONSENSE, ODD_DRIVE, SATURATION, FAULT, OUTSIDE = range(6)
"""Why; of the last, the reason came from outside."""


class InterlockParameters(NamedTuple):
    """What does not change of an interlock.

    Attributes
    ----------
    largest : float
        Magnitude of the reference force beyond which it is nonsense, N.
    window : int
        Steps of a second.
    closing : float
        Steps in which the valve closes once it has tripped.
    detectors : DetectorParameters
        Of faults.
    """

    largest: float
    window: int
    closing: float
    detectors: DetectorParameters


class InterlockState(NamedTuple):
    """What changes of it.

    Attributes
    ----------
    flags : ndarray
        See `TRIP`, shape (4,).
    saturated : ndarray
        The last steps at which the drive was limited, see `is_exceeded`.
    force, measured, odd : ndarray
        Reference force, sample and drive of the step at which it tripped, shapes (n,), (4, n)
        and (n,).
    drive : ndarray
        The last sound command, shape (n,), V.
    plan, sample : ndarray
        Points and sample that the controller is to answer, shapes (p, q, n) and (4, n).
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
    """Say whether a step is to be answered by the controller; else its command is given.

    The controller is to answer `InterlockState.plan` and `InterlockState.sample`. While a sample
    is suspect, these are the motion that the last sound target has predicted for this step;
    where there is no target, the last sound command holds. Once it has tripped, the valve closes
    from there: a valve that closes at once on a moving mass makes the oil hammer.

    Parameters
    ----------
    parameters, state
        The state is brought up to date.
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
        # a target is held against the motion, too
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
            trip(state, FAULT if fits else NONSENSE, step)
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
    """Let the controller answer a sample; remember what was asked for."""
    plan, sample, count = state.plan, state.sample, min(points.shape[0], state.plan.shape[0])
    alone = points.shape[1] < plan.shape[1]  # a force, as the nodes warm up
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
    """Look at the command of a controller, and whether it is limited; if it is odd, trip."""
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
