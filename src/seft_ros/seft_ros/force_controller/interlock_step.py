"""How the force control is protected, step by step, compiled."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from seft_plant_sim.compiled import compiled
from seft_plant_sim.rig.limits import is_exceeded

from seft_ros.interlock.plausibility import is_finite

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

TRIP, STEP, SATURATED = range(3)
"""Places of the flags: why it has tripped, at which step, and how often the drive was limited."""
NOTHING, NONSENSE, ODD_DRIVE, SATURATION = range(4)
"""Why."""


class InterlockParameters(NamedTuple):
    """What does not change of an interlock.

    Attributes
    ----------
    largest : float
        Magnitude of the reference force beyond which it is nonsense, N.
    window : int
        Steps of a second.
    """

    largest: float
    window: int


class InterlockState(NamedTuple):
    """What changes of it.

    Attributes
    ----------
    flags : ndarray
        See `TRIP`, shape (3,).
    saturated : ndarray
        The last steps at which the drive was limited, see `is_exceeded`.
    force, measured, drive : ndarray
        Reference force, sample and drive of the step at which it tripped, shapes (n,), (4, n)
        and (n,).
    """

    flags: Ints
    saturated: Ints
    force: Floats
    measured: Floats
    drive: Floats


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
        if fits:
            return True
        trip(state, NONSENSE, step)
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


@compiled
def trip(state: InterlockState, why: int, step: int) -> None:
    """Answer 0 V from now on."""
    state.flags[TRIP] = why
    state.flags[STEP] = step
