"""All steps of a test, for the compiler: `seft_ros.experiment.offline.simulate` over arrays.

The order of the steps, and of the layers of the interlock within each, is that of the blocks.
"""

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit
from numba.extending import register_jitable
from seft_plant_sim.rig_step import BLIND, LIMIT, RigParameters, RigState, rig_step

from seft_ros.interlock import instability, ramp_down

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

time_above = register_jitable(instability.time_above)
ramp_factor = register_jitable(ramp_down.ramp_factor)

OPTIONS: dict[str, Any] = {"fastmath": {"reassoc", "contract"}, "error_model": "numpy"}
"""Sums of the loop but not of the rig may be taken in any order: that makes them fast."""
NOTHING = 0
NONSENSE, SATURATION = 1, 2
"""What the force controller trips by."""
FORCE, STATE, INSTABILITY = 1, 2, 3
"""What the reference force comes down by."""


class ForceArrays(NamedTuple):
    """A `ProtectedForce` with linear compensation of s states.

    Attributes
    ----------
    matrix : ndarray
        Shape (n + s, s + 4n): takes (states, measured) to (force, states).
    driven : ndarray
        Shape (N, n + s): what the ground motion adds at each step.
    ground_motion : ndarray
        Shape (N, n).
    largest, most : float
        Of `PlausibleForce`.
    watch : ndarray
        `InstabilityWatch.product`.
    average, memory, patience, ratio, least : float
        Of it; ``least`` is the square of the floor.
    ramp_steps : int
        Of `RampDown`.
    """

    matrix: Floats
    driven: Floats
    ground_motion: Floats
    largest: float
    most: float
    watch: Floats
    average: float
    memory: float
    patience: float
    ratio: float
    least: float
    ramp_steps: int


class ControlArrays(NamedTuple):
    """An `Interlock` and its `ForceController`; ``drives_valve``: the rig obeys them."""

    matrix: Floats
    from_drive: Floats
    feedback: bool
    limit: float
    largest: float
    allowed: int
    window: int
    drives_valve: bool


class Course(NamedTuple):
    """What a test leaves, over N steps.

    Attributes
    ----------
    states, forces, commands : ndarray
        Shapes (N, 4, n), (N, n), (N, n).
    flags : ndarray
        What `rig_step` gave, shape (N,).
    odd_force : ndarray
        The first force that was not plausible, shape (n,).
    squares : ndarray
        Mean squares of the `InstabilityWatch`: of the model, measured, expected; shape (3, n).
    """

    states: Floats
    forces: Floats
    commands: Floats
    flags: Ints
    odd_force: Floats
    squares: Floats


def _multiply(matrix: Floats, vector: Floats, result: Floats) -> None:
    for row in range(matrix.shape[0]):
        total = 0.0
        for column in range(matrix.shape[1]):
            total += matrix[row, column] * vector[column]
        result[row] = total


def _watch(
    force: ForceArrays, step: int, above: float, measured: Floats, work: Floats, result: Floats,
    squares: Floats,
) -> float:  # fmt: skip
    """`InstabilityWatch.step`; gives the steps for which vibration has been there."""
    n = measured.shape[1]
    states = len(work) - 2 * n
    for i in range(n):
        work[states + i] = force.ground_motion[step, i]
        work[states + n + i] = measured[2, i]
    multiply(force.watch, work, result)
    work[:states] = result[:states]
    old, new = force.average, 1.0 - force.average
    excess = 0.0
    for i in range(n):
        squares[0, i] = old * squares[0, i] + new * result[states + i] ** 2
        squares[1, i] = old * squares[1, i] + new * result[states + n + i] ** 2
        squares[2, i] = max(squares[0, i], squares[2, i] * force.memory, force.least)
        excess = max(excess, squares[1, i] / squares[2, i])
    return time_above(above, excess / force.ratio**2)


def _exceeds(times: Ints, count: int, window: int, allowed: int) -> bool:
    """Say whether more of the last ``count`` times than allowed are within the window."""
    return count > allowed and times[count - 1 - allowed] > times[count - 1] - window


def run(
    parameters: RigParameters, state: RigState, noise: Floats, force: ForceArrays,
    control: ControlArrays, course: Course,
) -> tuple[int, int, int, int, int]:  # fmt: skip
    """Run a test.

    Returns
    -------
    steps : int
        Samples taken.
    violation, interlock, cause, cause_step : int
        What the rig, the force controller and the reference force came down by, and at which
        step the last of them began to.
    """
    total, n = course.forces.shape
    command = np.zeros(n)
    force_work = np.zeros(force.matrix.shape[1])
    force_result = np.zeros(force.matrix.shape[0])
    filter_states = len(force_result) - n
    control_work, control_result = np.zeros(len(control.matrix)), np.zeros(len(control.matrix))
    delays = len(control_work) - n
    watch_work, watch_result = np.zeros(len(force.watch)), np.zeros(len(force.watch))
    course.squares[:2] = 0.0
    course.squares[2] = force.least
    limited_at = np.zeros(total, np.int64)
    limited_count = 0
    plausible, drive = np.zeros(n), np.zeros(n)
    above, holding, taken = 0.0, False, 0
    violation = interlock = cause = cause_step = NOTHING
    step = 0
    while True:
        measured = course.states[step]
        course.flags[step] = rig_step(parameters, state, step, command, noise[step], measured)
        violation = course.flags[step] & (LIMIT | BLIND)
        # ---- reference force
        for row in range(4):
            for i in range(n):
                force_work[filter_states + row * n + i] = measured[row, i]
        multiply(force.matrix, force_work, force_result)
        for i in range(len(force_result)):
            force_result[i] += force.driven[step, i]
        force_work[:filter_states] = force_result[n:]
        fault = NOTHING
        if not holding:
            for i in range(n):
                value = force_result[i]
                small, slow = abs(value) <= force.largest, abs(value - plausible[i]) <= force.most
                if not (small and slow):
                    fault = FORCE
            if fault:
                holding = True
                course.odd_force[:] = force_result[:n]
            else:
                plausible[:] = force_result[:n]
        if not cause:
            cause = fault
            if not cause:
                for row in range(4):
                    for i in range(n):
                        if not math.isfinite(measured[row, i]):
                            cause = STATE
            if not cause and force.ratio:
                above = watch(
                    force, step, above, measured, watch_work, watch_result, course.squares
                )
                if above >= force.patience:
                    cause = INSTABILITY
            cause_step = step if cause else NOTHING
        if cause:
            taken += 1
            factor = 0.0
            if taken < force.ramp_steps:
                factor = ramp_factor(taken, force.ramp_steps)
            for i in range(n):
                course.forces[step, i] = plausible[i] * factor
        else:
            course.forces[step] = force_result[:n]
        asked = course.forces[step]
        # ---- force control
        for i in range(n):
            if abs(asked[i]) > control.largest or not (
                math.isfinite(asked[i]) and math.isfinite(measured[3, i])
            ):
                interlock = NONSENSE
            control_work[delays + i] = asked[i] - measured[3, i] if control.feedback else asked[i]
        limited = False
        if not interlock:
            multiply(control.matrix, control_work, control_result)
            for i in range(n):
                value, limit = control_result[i], control.limit
                drive[i] = limit if value > limit else -limit if value < -limit else value
                if abs(drive[i]) >= limit:
                    limited = True
            for i in range(delays):
                control_work[i] = control_result[n + i]
                if limited:
                    for j in range(n):
                        lost = drive[j] - control_result[j]
                        control_work[i] -= control.from_drive[i, j] * lost
            if limited:
                limited_at[limited_count] = step
                limited_count += 1
                if exceeds(limited_at, limited_count, control.window, control.allowed):
                    interlock = SATURATION
        if interlock:
            drive[:] = 0.0
        course.commands[step] = drive
        step += 1
        if step == total or violation or interlock or taken >= force.ramp_steps:
            return step, violation, interlock, cause, cause_step
        for i in range(n):
            command[i] = drive[i] if control.drives_valve else asked[i]


multiply = njit(forceinline=True, **OPTIONS)(_multiply)
watch = njit(forceinline=True, **OPTIONS)(_watch)
exceeds = njit(forceinline=True, **OPTIONS)(_exceeds)
