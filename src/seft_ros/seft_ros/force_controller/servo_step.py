"""The steps of `PositionServo`: commands for a motion that is known ahead, and what is followed."""

import math
from typing import NamedTuple

from seft_msgs_py.arrays import Floats
from seft_plant_sim.compiled import compiled
from seft_plant_sim.judge.valve_following import (
    LARGEST_DELAY_ERROR,
    LARGEST_GAIN_ERROR,
    UNCERTAIN_DELAY,
    UNCERTAIN_GAIN,
)

from seft_ros.force_controller.feedforward_step import DELAY_ERROR, GAIN_ERROR
from seft_ros.protection.protection_step import slow_down

SERVO_ERRORS = 3
"""Number of errors of a servo: of gain, delay, and displacement."""
OFFSET = 2
"""Column of ``errors`` after `GAIN_ERROR` and `DELAY_ERROR`."""
_DRIFT = 2e-3
"""Undetected slow change of gain and delay in a second, over their deviation at the beginning."""
_UNDESCRIBED, _UNDESCRIBED_TIME = 3e-3, 3e-5
"""What gain and delay do not describe: part of the displacement, and time of the velocity, s."""
_CORRELATION_TIME = 0.02
"""Of that, s: within it, samples count as one."""


class ServoParameters(NamedTuple):
    """Parameters of a controller of n servos, each of m states.

    Attributes
    ----------
    dt, limit : float
        Sampling period, s, and largest command, m.
    late : float
        Time from a sample to the first effect of the command that answers it, as measured, in
        periods.
    free, push, output : ndarray
        The response to a held command without its dead time, z+ = F z + g u, y = c z; shapes
        (n, m, m), (n, m) and (n, m).
    rest : ndarray
        z and u for a displacement of 1 m at rest, shape (n, m + 1).
    feedback : ndarray
        Second difference of the command per z, last command and its last change, (n, m + 2).
    ahead : ndarray
        And per motion that is wanted of the next samples on; shape (n, taps).
    noise : ndarray
        RMS noise of the displacement, shape (n,), m.
    rate : ndarray
        With which the displacement's error is followed, W, shape (n,), 1/s.
    """

    dt: float
    limit: float
    late: Floats
    free: Floats
    push: Floats
    output: Floats
    rest: Floats
    feedback: Floats
    ahead: Floats
    noise: Floats
    rate: Floats


class ServoState(NamedTuple):
    """State of the controller.

    Attributes
    ----------
    model, next : ndarray
        z of the response, last command and its change; shape (n, m + 2), and room.
    past : ndarray
        Displacement by the response, the newest first, shape (n, memory), m.
    wanted : ndarray
        Motion that is wanted of the response, room of shape (taps,), m.
    errors, covariance : ndarray
        Of gain (relative), delay (s) and displacement (m), shapes (n, 3) and (n, 3, 3).
    work : ndarray
        Room, shape (2, 3).
    steps : ndarray
        Samples taken, shape (1,).
    """

    model: Floats
    next: Floats
    past: Floats
    wanted: Floats
    errors: Floats
    covariance: Floats
    work: Floats
    steps: Floats


@compiled
def begin_servo(state: ServoState) -> None:
    """Begin a test with the response as identified."""
    state.steps[0] = 0.0
    state.errors[:] = 0.0
    state.covariance[:] = 0.0
    for i in range(len(state.covariance)):
        state.covariance[i, GAIN_ERROR, GAIN_ERROR] = UNCERTAIN_GAIN**2
        state.covariance[i, DELAY_ERROR, DELAY_ERROR] = UNCERTAIN_DELAY**2


@compiled
def servo_step(
    parameters: ServoParameters,
    state: ServoState,
    points: Floats,
    measured: Floats,
    command: Floats,
) -> bool:
    """Find the commands that answer a sample.

    Parameters
    ----------
    parameters, state
        The state is updated.
    points : ndarray
        Displacement, velocity and force of the target at this step and the future ones, shape
        (late + taps + 2 or more, 3, n).
    measured : ndarray
        Displacement, velocity, acceleration and force, shape (4, n).
    command : ndarray
        The result, shape (n,), m.

    Returns
    -------
    bool
        Whether one of them is at its limit.
    """
    p = parameters
    for i in range(len(command)):
        if state.steps[0] == 0.0:
            _rest_at(p, state, i, points[0, 0, i])
        else:
            _follow(p, state, i, measured[0, i])
    state.steps[0] += 1.0
    return move_servos(p, state, points, command)


@compiled
def move_servos(p: ServoParameters, state: ServoState, points: Floats, command: Floats) -> bool:
    """Find the commands for the target's motion, see `servo_step`."""
    limited, (n, m) = False, p.push.shape
    for i in range(n):
        z, new, last = state.model[i], state.next[i], state.model.shape[1] - 2
        _want(p, state, i, points)
        bend = 0.0
        for j in range(m + 2):
            bend -= p.feedback[i, j] * z[j]
        for j in range(len(state.wanted)):
            bend += p.ahead[i, j] * state.wanted[j]
        u = z[last] + z[last + 1] + bend
        if abs(u) >= p.limit:
            limited = True
            u = p.limit if u > 0.0 else -p.limit
        command[i] = u
        y = 0.0
        for row in range(m):
            new[row] = p.push[i, row] * u
            for j in range(m):
                new[row] += p.free[i, row, j] * z[j]
            y += p.output[i, row] * new[row]
        new[last], new[last + 1] = u, u - z[last]
        for j in range(m + 2):
            z[j] = new[j]
        past = state.past[i]
        for j in range(len(past) - 1, 0, -1):
            past[j] = past[j - 1]
        past[0] = y
    return limited


@compiled
def _rest_at(p: ServoParameters, state: ServoState, i: int, x: float) -> None:
    """Begin with a servo that rests at a displacement."""
    m = p.push.shape[1]
    for j in range(m + 1):
        state.model[i, j] = p.rest[i, j] * x
    state.model[i, m + 1] = 0.0
    state.past[i, :] = x


@compiled
def _want(p: ServoParameters, state: ServoState, i: int, points: Floats) -> None:
    """Write what the response must do from the next sample on, for the target's motion.

    The displacement is (1 + e_gain) y - e_delay y' + offset, after the dead time.
    """
    errors, wanted = state.errors[i], state.wanted
    after = p.late[i] + errors[DELAY_ERROR] / p.dt
    whole = math.floor(after)
    s = after - whole  # cubic between the points, by their velocities
    one, by_rate = s * s * (3.0 - 2.0 * s), p.dt * s * (1.0 - s)
    for j in range(len(wanted)):
        k = whole + j + 1
        if k < 0:  # faster than identified: what it must do now was wanted before, a parabola
            since = (k + s) * p.dt
            rise = (points[1, 1, i] - points[0, 1, i]) / p.dt
            x = points[0, 0, i] + since * (points[0, 1, i] + 0.5 * since * rise)
        else:
            x, v = points[k, 0, i], points[k, 1, i]
            x += one * (points[k + 1, 0, i] - x)
            x += by_rate * ((1.0 - s) * v - s * points[k + 1, 1, i])
        wanted[j] = (x - errors[OFFSET]) / (1.0 + errors[GAIN_ERROR])


@compiled
def _follow(p: ServoParameters, state: ServoState, i: int, x: float) -> None:
    """Update the errors of a servo by a measured displacement (Kalman filter)."""
    errors, covariance, past = state.errors[i], state.covariance[i], state.past[i]
    regressor, work = state.work[0], state.work[1]
    whole = int(p.late[i])
    part = p.late[i] - whole
    newer = past[whole - 1] if whole > 0 else past[0]
    y = past[whole] + part * (past[whole + 1] - past[whole])
    rate = ((1.0 - part) * (newer - past[whole + 1]) + part * (past[whole] - past[whole + 2])) / (
        2.0 * p.dt
    )
    regressor[GAIN_ERROR], regressor[DELAY_ERROR], regressor[OFFSET] = y, -rate, 1.0
    variance = p.noise[i] ** 2 + (_UNDESCRIBED * abs(y) + _UNDESCRIBED_TIME * abs(rate)) ** 2
    variance *= max(1.0, _CORRELATION_TIME / p.dt)
    covariance[GAIN_ERROR, GAIN_ERROR] += (_DRIFT * UNCERTAIN_GAIN) ** 2 * p.dt
    covariance[DELAY_ERROR, DELAY_ERROR] += (_DRIFT * UNCERTAIN_DELAY) ** 2 * p.dt
    covariance[OFFSET, OFFSET] += (p.rate[i] * p.dt) ** 2 * variance
    missed, total = x - y, variance
    for j in range(SERVO_ERRORS):
        missed -= errors[j] * regressor[j]
        work[j] = 0.0
        for k in range(SERVO_ERRORS):
            work[j] += covariance[j, k] * regressor[k]
        total += regressor[j] * work[j]
    for j in range(SERVO_ERRORS):
        errors[j] += work[j] * missed / total
        for k in range(SERVO_ERRORS):
            covariance[j, k] -= work[j] * work[k] / total
    errors[GAIN_ERROR] = _within(errors[GAIN_ERROR], LARGEST_GAIN_ERROR)
    errors[DELAY_ERROR] = _within(errors[DELAY_ERROR], LARGEST_DELAY_ERROR)


@compiled
def _within(value: float, largest: float) -> float:
    return min(max(value, -largest), largest)


@compiled
def servo_stop(
    parameters: ServoParameters,
    state: ServoState,
    plan: Floats,
    slowed: Floats,
    commands: Floats,
) -> None:
    """Find the commands that bring the rig to rest along a plan.

    Parameters
    ----------
    parameters, state
        See `servo_step`; the state is used up.
    plan, slowed : ndarray
        See `slow_down`; the second is room of shape (N + late + taps + 3, 3, n).
    commands : ndarray
        From the step after that of the plan on, shape (N, n), m. The result.
    """
    slow_down(plan, len(commands), parameters.dt, slowed)
    for j in range(len(commands)):
        move_servos(parameters, state, slowed[j + 1 :], commands[j])


def memory_of(late: float) -> int:
    """Count the past displacements of the response that `servo_step` needs, by ``late``."""
    return math.floor(late) + 4
