"""All steps of a test, for the compiler: `seft_ros.experiment.offline.simulate` over arrays.

The order of the steps, and of the layers of the interlock within each, is that of the blocks.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit
from numba.extending import register_jitable

from seft_ros.ensemble.rig_step import OPTIONS, PlantArrays, integrate, multiply
from seft_ros.interlock import instability, ramp_down

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

time_above = register_jitable(instability.time_above)
ramp_factor = register_jitable(ramp_down.ramp_factor)

STROKE, FORCE_CAPACITY, VALVE = 16, 32, 64
"""Bits of what is at the end of its range; the first four are the sensors' channels."""
NOTHING = 0
LIMIT, BLIND = 1, 2
"""What the rig trips by."""
NONSENSE, SATURATION = 1, 2
"""What the force controller trips by."""
FORCE, STATE, INSTABILITY = 1, 2, 3
"""What the reference force comes down by."""


class SensorArrays(NamedTuple):
    """Sensors of n axes over N steps, and what of them trips the rig.

    Attributes
    ----------
    noise : ndarray
        Shape (N, 4, n).
    bias, range, resolution, per_resolution : ndarray
        Shape (4, n), see `Channels`; ``per_resolution`` is 1 / resolution.
    converts, derives : bool
        Whether there are converters, and whether the velocity is derived.
    pole, gain : float
        Of the `Differentiator`.
    limits : ndarray
        `Limits.limits`, shape (8,).
    allowed, window : int
        Of the `SaturatedTime`.
    """

    noise: Floats
    bias: Floats
    range: Floats
    resolution: Floats
    per_resolution: Floats
    converts: bool
    derives: bool
    pole: float
    gain: float
    limits: Floats
    allowed: int
    window: int


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
        What is at the end of its range, as bits, shape (N,).
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


def _measure(
    sensors: SensorArrays, step: int, true: Floats, before: Floats, measured: Floats
) -> int:
    """`Sensors.measure` of (4n,) values; ``before`` is the last sample. Gives the bits."""
    flags = 0
    n = sensors.bias.shape[1]
    for row in range(4):
        for i in range(n):
            value = true[row * n + i] + sensors.noise[step, row, i] + sensors.bias[row, i]
            limit = sensors.range[row, i]
            if sensors.converts:
                value *= sensors.per_resolution[row, i]
                limit *= sensors.per_resolution[row, i]
            if abs(value) >= limit:
                flags |= 1 << row
                value = limit if value > 0 else -limit
            if sensors.converts:
                value = np.rint(value) * sensors.resolution[row, i]
            measured[row, i] = value
    if sensors.derives:
        for i in range(n):
            v = 0.0
            if step:
                change = measured[0, i] - before[0, i]
                v = sensors.pole * before[1, i] + sensors.gain * change
            measured[1, i] = v
    return flags


def _breaks_limit(limits: Floats, step: int, before: Floats, measured: Floats) -> bool:
    for row in range(4):
        for i in range(measured.shape[1]):
            change = measured[row, i] - before[row, i] if step else 0.0
            if not (abs(measured[row, i]) <= limits[row] and abs(change) <= limits[4 + row]):
                return True
    return False


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
    plant: PlantArrays, sensors: SensorArrays, force: ForceArrays, control: ControlArrays,
    course: Course,
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
    linear = len(plant.linear) > 0
    size = plant.linear.shape[0] - 4 * n if linear else len(plant.predict[0])
    rig_work = np.zeros(plant.linear.shape[1] if linear else plant.predict[0].shape[1])
    rig_result, z = np.zeros(size + 4 * n), np.zeros(size)
    residuals = np.zeros(plant.correct[0].shape[1])
    true = np.zeros(4 * n)
    line = plant.whole + 2
    drives = np.zeros((total + line, n))  # of every step, after those from before the test
    force_work = np.zeros(force.matrix.shape[1])
    force_result = np.zeros(force.matrix.shape[0])
    filter_states = len(force_result) - n
    control_work, control_result = np.zeros(len(control.matrix)), np.zeros(len(control.matrix))
    delays = len(control_work) - n
    watch_work, watch_result = np.zeros(len(force.watch)), np.zeros(len(force.watch))
    course.squares[:2] = 0.0
    course.squares[2] = force.least
    blind_at, limited_at = np.zeros(total, np.int64), np.zeros(total, np.int64)
    blind_count = limited_count = 0
    plausible, drive = np.zeros(n), np.zeros(n)
    above, holding, taken = 0.0, False, 0
    violation = interlock = cause = cause_step = NOTHING
    step = 0
    while True:
        measured = course.states[step]
        before = course.states[step - 1] if step else measured
        # ---- the rig measures
        flags = measure(sensors, step, true, before, measured)
        if breaks_limit(sensors.limits, step, before, measured):
            violation = LIMIT
        elif flags:
            blind_at[blind_count] = step
            blind_count += 1
            if exceeds(blind_at, blind_count, sensors.window, sensors.allowed):
                violation = BLIND
        for i in range(len(plant.piston)):
            if abs(rig_work[i]) >= plant.piston[i, 2]:
                flags |= STROKE
            if abs(rig_work[2 * n + i]) >= plant.piston[i, 1]:
                flags |= FORCE_CAPACITY
            if abs(rig_work[3 * n + i]) >= plant.piston[i, 0]:
                flags |= VALVE
        course.flags[step] = flags
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
        # ---- the rig moves
        for i in range(n):
            value, limit = drive[i] if control.drives_valve else asked[i], plant.drive_limit[i]
            drives[line + step - 1, i] = min(max(value, -limit), limit)
        first, now = drives[step - 1], drives[step + 1]
        if plant.part:
            now = drives[step]
        if linear:
            for i in range(n):
                rig_work[size + i] = first[i]
                rig_work[size + n + i] = drives[step, i]
                rig_work[size + 2 * n + i] = now[i]
            multiply(plant.linear, rig_work, rig_result)
            rig_work[:size] = rig_result[:size]
            true[:] = rig_result[size:]
        else:
            integrate(plant, n, drives, step - 1, rig_work, z, residuals)
            for i in range(n):
                rig_work[size + i] = now[i]
            multiply(plant.output, rig_work, true)


measure = njit(forceinline=True, **OPTIONS)(_measure)
breaks_limit = njit(forceinline=True, **OPTIONS)(_breaks_limit)
watch = njit(forceinline=True, **OPTIONS)(_watch)
exceeds = njit(forceinline=True, **OPTIONS)(_exceeds)
