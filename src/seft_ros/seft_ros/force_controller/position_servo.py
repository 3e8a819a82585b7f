"""Force control by a displacement servo: its vendor's controller moves the valve.

Of it the response from command u to displacement is known, y = G(s) u, as `seft identify` finds it
with the specimen in place. The displacement is (1 + e_gain) y - e_delay y' + d. A Kalman filter
follows these errors on the measured displacement: d is what gain and delay do not explain (the
specimen that yields, friction, valve and supply), and changes at the rate W of
`oil_column.crossover`, which the delay allows.

The command inverts the response for the target's motion, which is known ahead. It minimises, with
the second difference of the command, the sum of

    (y - (x* - d) / (1 + e_gain))^2 + (|G(W_h)| / (W_h dt)^2)^2 (u[k] - 2 u[k-1] + u[k-2])^2   (8)

over all samples, y one dead time ahead: the linear-quadratic tracking problem with preview
(Tomizuka 1975). Its solution inverts G up to W_h, where the servo does no more than `LEAST_GAIN` of
a command, whatever its poles and zeros are; it knows where past commands have brought the servo.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats, zeros
from seft_msgs_py.config.parameter_table import Section
from seft_plant_sim.compiled import bounded, compiled, dot, put_first
from seft_plant_sim.judge import valve_following
from seft_plant_sim.judge.known_rig import command_limit, known_responses
from seft_plant_sim.judge.servo_model import ServoModel, servo_models
from seft_plant_sim.lti import TransferFunction
from seft_plant_sim.rig_parameters import common_lag

from seft_ros.force_controller import force_control
from seft_ros.force_controller.force_control import DELAY_ERROR, GAIN_ERROR, TargetFollower
from seft_ros.force_controller.force_controller_parameters import POSITION_SERVO_METHOD
from seft_ros.force_controller.oil_column import cost_to_go, fastest_feedback
from seft_ros.force_controller.stop_path import StopPath, path_to_rest
from seft_ros.reference_force.observers import sensor_noise

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
    """State of the controller: arrays of zeros, but for ``covariance``."""

    model: Annotated[Floats, "n", "states"]  # of the response without dead time, then last command
    # and its last change, m
    next: Annotated[Floats, "n", "states"]  # room
    past: Annotated[Floats, "n", "memory"]  # displacements of the response, the newest first, m
    wanted: Annotated[Floats, "taps"]  # what the response must do from the next sample on, m
    errors: Annotated[Floats, "n", SERVO_ERRORS]
    covariance: Annotated[Floats, "n", SERVO_ERRORS, SERVO_ERRORS]
    work: Annotated[Floats, 2, SERVO_ERRORS]
    steps: Annotated[Floats, 1]  # samples taken


@compiled
def servo_step(
    p: ServoParameters, state: ServoState, points: Floats, measured: Floats, command: Floats
) -> bool:
    """Find the commands that answer a sample.

    Parameters
    ----------
    p, state
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
        bend = dot(len(state.wanted), p.ahead[i], state.wanted) - dot(m + 2, p.feedback[i], z)
        u = z[last] + z[last + 1] + bend
        limited |= abs(u) >= p.limit
        u = command[i] = bounded(u, p.limit)
        for row in range(m):
            new[row] = p.push[i, row] * u + dot(m, p.free[i, row], z)
        y = dot(m, p.output[i], new)
        new[last], new[last + 1] = u, u - z[last]
        for j in range(m + 2):
            z[j] = new[j]
        put_first(state.past[i], y)
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
    rate = (1.0 - part) * (newer - past[whole + 1]) + part * (past[whole] - past[whole + 2])
    rate /= 2.0 * p.dt
    regressor[GAIN_ERROR], regressor[DELAY_ERROR], regressor[OFFSET] = y, -rate, 1.0
    variance = p.noise[i] ** 2 + (_UNDESCRIBED * abs(y) + _UNDESCRIBED_TIME * abs(rate)) ** 2
    variance *= max(1.0, _CORRELATION_TIME / p.dt)
    covariance[GAIN_ERROR, GAIN_ERROR] += (_DRIFT * valve_following.UNCERTAIN_GAIN) ** 2 * p.dt
    covariance[DELAY_ERROR, DELAY_ERROR] += (_DRIFT * valve_following.UNCERTAIN_DELAY) ** 2 * p.dt
    covariance[OFFSET, OFFSET] += (p.rate[i] * p.dt) ** 2 * variance
    valve_following.correct_errors(errors, covariance, regressor, x - y, variance, work)
    errors[GAIN_ERROR] = bounded(errors[GAIN_ERROR], valve_following.LARGEST_GAIN_ERROR)
    errors[DELAY_ERROR] = bounded(errors[DELAY_ERROR], valve_following.LARGEST_DELAY_ERROR)


@compiled
def servo_stop(
    parameters: ServoParameters,
    state: ServoState,
    stop: StopPath,
    plan: Floats,
    path: Floats,
    commands: Floats,
) -> None:
    """Find the commands that bring the rig to rest along a plan.

    Parameters
    ----------
    parameters, state
        See `servo_step`; the state is used up.
    stop, plan, path
        See `path_to_rest`; the last is room of shape (N + late + taps + 3, 3, n).
    commands : ndarray
        From the step after that of the plan on, shape (N, n), m. The result.
    """
    path_to_rest(stop, plan, path)
    for j in range(len(commands)):
        move_servos(parameters, state, path[j + 1 :], commands[j])


LEAST_GAIN = 0.2
"""Displacement per command down to which the response is inverted, over that at rest: more would
take commands of five times the motion."""
NEGLIGIBLE = 0.05
"""Part of the weights of the coming motion that may be left to a linear continuation of it."""


class PositionServo(TargetFollower):
    """Force controller of n axes that commands displacement servos for the future motion.

    Its errors are those of the gain (relative), the delay (s), and the displacement (m). The
    response of the servos must be known.
    """

    method = POSITION_SERVO_METHOD
    names = "gain_error", "delay_error", "displacement_error"
    uncertain = valve_following.UNCERTAIN_GAIN, valve_following.UNCERTAIN_DELAY, 0.0
    functions = servo_step, servo_stop

    def _known(
        self, section: Section, axes: tuple[str, ...], own: list[int], dt: float
    ) -> tuple[ServoParameters, ServoState, int, int]:
        lag, responses = common_lag(section), known_responses(section, axes, own)
        models = servo_models(responses, dt)
        servos = [InvertedServo(*each, dt) for each in zip(models, responses, strict=True)]
        n, taps = len(servos), max(servo.taps for servo in servos)
        late = np.array([(each.dead_time + lag) / dt + 1.0 for each in responses])
        needed = int(np.ceil(late.max() + valve_following.LARGEST_DELAY_ERROR / dt)) + taps + 2
        horizon = force_control.horizon_of(section, dt, needed, "servos")
        delay = np.array([servo.model.delay for servo in servos]) + late * dt + dt / 2
        parameters = ServoParameters(
            dt=dt,
            limit=command_limit(section),
            late=late,
            free=np.array([servo.model.free for servo in servos]),
            push=np.array([servo.model.push for servo in servos]),
            output=np.array([servo.model.output for servo in servos]),
            rest=np.array([servo.model.rest for servo in servos]),
            feedback=np.array([servo.feedback for servo in servos]),
            ahead=np.array([servo.ahead(taps) for servo in servos]),
            noise=sensor_noise(section, axes)[0, own],
            rate=fastest_feedback(delay),
        )
        states = parameters.feedback.shape[1]
        sizes = {"n": n, "states": states, "memory": math.floor(late.max()) + 4, "taps": taps}
        return parameters, zeros(ServoState, sizes), horizon, needed


class InvertedServo:
    """A servo without its dead time, and the inverse of its response by Eq. (8).

    Parameters
    ----------
    model : ServoModel
        Of m states.
    response : TransferFunction
        From command to displacement.
    dt : float
        Sampling period, s.

    Attributes
    ----------
    model : ServoModel
        As given.
    feedback : ndarray
        See `ServoParameters`, shape (m + 2,).
    taps : int
        Sufficient number of coming samples.
    """

    def __init__(self, model: ServoModel, response: TransferFunction, dt: float) -> None:
        self.model = model
        m = len(model.push)
        # the command of the last sample, and its last change
        whole = np.zeros((m + 2, m + 2))
        whole[:m, :m], whole[:m, m:] = model.free, model.push[:, np.newaxis]
        whole[m], whole[m + 1, m + 1] = [*np.zeros(m), 1.0, 1.0], 1.0
        bend = np.append(model.push, [1.0, 1.0])[:, np.newaxis]
        seen = np.append(model.output, [0.0, 0.0])
        effort = self._effort(response, dt) * np.eye(1)
        p = cost_to_go(whole, bend, np.outer(seen, seen), effort)
        weight = effort + bend.T @ p @ bend
        self.feedback = np.linalg.solve(weight, bend.T @ p @ whole)[0]
        closed = whole - bend @ self.feedback[np.newaxis]
        self._weights = self._coming(closed, np.linalg.solve(weight, bend.T)[0], seen, dt)
        left = np.cumsum(np.abs(self._weights[::-1]))[::-1]
        self.taps = max(3, int(np.searchsorted(-left, -NEGLIGIBLE * left[0])))

    @staticmethod
    def _effort(response: TransferFunction, dt: float) -> float:
        """Weight of the second difference of the command, (|G(W_h)| / (W_h dt)^2)^2."""
        f = np.append(np.geomspace(1e-4, 0.5, 2000) / dt, 0.0)
        *size, static = np.abs(response.response(f)).tolist()
        highest = int(np.argmax([*(np.array(size) < LEAST_GAIN * static), True]))
        highest = min(highest, len(size) - 1)
        return float((size[highest] / (2.0 * np.pi * f[highest] * dt) ** 2) ** 2)

    @staticmethod
    def _coming(closed: Floats, by_state: Floats, seen: Floats, dt: float) -> Floats:
        """Second difference of the command per coming displacement, the next first."""
        weights, adjoint = [], seen.copy()
        for _ in range(max(20, round(1.0 / dt))):
            weights.append(float(by_state @ adjoint))
            adjoint = closed.T @ adjoint
        return np.array(weights)

    def ahead(self, taps: int) -> Floats:
        """Weights of so many coming samples; the motion continues linearly after them."""
        weights, beyond = self._weights[:taps].copy(), self._weights[taps:]
        after = np.arange(1, len(beyond) + 1)
        weights[-1] += ((1.0 + after) * beyond).sum()
        weights[-2] -= (after * beyond).sum()
        return weights
