"""How the force control is protected, step by step, compiled."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from seft_plant_sim.compiled import compiled
from seft_plant_sim.rig.limits import is_exceeded

from seft_ros.interlock.detector_step import (
    DetectorParameters,
    DetectorState,
    begin_detectors,
    detect,
    take_command,
)
from seft_ros.interlock.plausibility import is_finite

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

TRIP, STEP, SATURATED, DETECTED = range(4)
"""Places of the flags: why it has tripped, at which step, how often the drive was limited, and which
detector has found a fault."""
NOTHING, NONSENSE, ODD_DRIVE, SATURATION, FAULT = range(5)
"""Why."""


class InterlockParameters(NamedTuple):
    """What does not change of an interlock.

    Attributes
    ----------
    largest : float
        Magnitude of the reference force beyond which it is nonsense, N.
    window : int
        Steps of a second.
    detectors : DetectorParameters
        Of faults.
    """

    largest: float
    window: int
    detectors: DetectorParameters


class InterlockState(NamedTuple):
    """What changes of it.

    Attributes
    ----------
    flags : ndarray
        See `TRIP`, shape (4,).
    saturated : ndarray
        The last steps at which the drive was limited, see `is_exceeded`.
    force, measured, drive : ndarray
        Reference force, sample and drive of the step at which it tripped, shapes (n,), (4, n)
        and (n,).
    detectors : DetectorState
        Of faults.
    """

    flags: Ints
    saturated: Ints
    force: Floats
    measured: Floats
    drive: Floats
    detectors: DetectorState


@compiled
def begin_interlock(state: InterlockState) -> None:
    """Begin a test."""
    state.flags[:] = 0
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
    """Say whether a step may be answered by the controller; else its command is 0 V.

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
    last, n = points.shape[1] - 1, points.shape[2]
    if state.flags[TRIP] == NOTHING:
        # a target is held against the motion, too
        fits = is_finite(measured, 0 if last else 3)
        for i in range(n):
            fits &= abs(points[0, last, i]) <= parameters.largest
        found = -1
        if fits and is_finite(measured, 0):  # without feedback, the motion need not be measured
            found = detect(parameters.detectors, state.detectors, step, points, measured)
        if fits and found < 0:
            return True
        trip(state, NONSENSE if found < 0 else FAULT, step)
        state.flags[DETECTED] = found
        for i in range(n):
            state.force[i] = points[0, last, i]
            for row in range(4):
                state.measured[row, i] = measured[row, i]
    command[:] = 0.0
    return False


@compiled
def end_control(
    parameters: InterlockParameters,
    state: InterlockState,
    step: int,
    limited: bool,
    command: Floats,
) -> None:
    """Look at the command of a controller, and whether it is limited: what must not be is 0 V."""
    for i in range(len(command)):
        if not np.isfinite(command[i]):
            trip(state, ODD_DRIVE, step)
    if limited and state.flags[TRIP] == NOTHING:
        if is_exceeded(state.saturated, state.flags[SATURATED], step, parameters.window):
            trip(state, SATURATION, step)
        state.flags[SATURATED] += 1
    if state.flags[TRIP] != NOTHING:
        for i in range(len(command)):
            state.drive[i] = command[i]
            command[i] = 0.0
    take_command(parameters.detectors, state.detectors, command)


@compiled
def trip(state: InterlockState, why: int, step: int) -> None:
    """Answer 0 V from now on."""
    state.flags[TRIP] = why
    state.flags[STEP] = step
