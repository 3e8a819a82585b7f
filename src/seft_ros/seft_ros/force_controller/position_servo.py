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

from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.wire.topics import RigAxes, Timebase
from seft_plant_sim.judge.known_rig import command_limit, known_responses
from seft_plant_sim.judge.servo_model import ServoModel, servo_models
from seft_plant_sim.judge.valve_following import LARGEST_DELAY_ERROR
from seft_plant_sim.lti import TransferFunction
from seft_plant_sim.rig_parameters import common_lag

from seft_ros.force_controller.force_controller_parameters import POSITION_SERVO_METHOD
from seft_ros.force_controller.oil_column import cost_to_go, fastest_feedback
from seft_ros.force_controller.servo_step import (
    SERVO_ERRORS,
    ServoParameters,
    ServoState,
    begin_servo,
    memory_of,
    servo_step,
    servo_stop,
)
from seft_ros.force_controller.target_follower import TargetFollower, horizon_of
from seft_ros.reference_force.observers import sensor_noise

LEAST_GAIN = 0.2
"""Displacement per command down to which the response is inverted, over that at rest: more would
take commands of five times the motion."""
NEGLIGIBLE = 0.05
"""Part of the weights of the coming motion that may be left to a linear continuation of it."""


class PositionServo(TargetFollower):
    """Force controller of n axes that commands displacement servos for the future motion.

    Its errors are those of the gain (relative), the delay (s), and the displacement (m).

    Parameters
    ----------
    section : dict
        Of the force controller, for all axes.
    axes : tuple of str
        Names of all axes.
    timebase : Timebase
        Sampling clock.
    rig : RigAxes, optional
        With several rigs, the one that it controls; default all axes.

    Raises
    ------
    InputError
        If the response is not known, or the horizon is too short for it.
    """

    method = POSITION_SERVO_METHOD
    names = "gain_error", "delay_error", "displacement_error"

    def __init__(
        self,
        section: dict[str, Any],
        axes: tuple[str, ...],
        timebase: Timebase,
        rig: RigAxes | None = None,
    ) -> None:
        own, dt = list((rig or RigAxes.whole(axes)).places), timebase.dt
        lag, responses = common_lag(section), known_responses(section, axes, own)
        models = servo_models(responses, dt)
        servos = [InvertedServo(*each, dt) for each in zip(models, responses, strict=True)]
        n, taps = len(servos), max(servo.taps for servo in servos)
        late = np.array([(each.dead_time + lag) / dt + 1.0 for each in responses])
        needed = int(np.ceil(late.max() + LARGEST_DELAY_ERROR / dt)) + taps + 2
        horizon = horizon_of(section, dt, needed, "servos")
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
        state = ServoState(
            model=np.zeros((n, states)),
            next=np.zeros((n, states)),
            past=np.zeros((n, memory_of(late.max()))),
            wanted=np.zeros(taps),
            errors=np.zeros((n, SERVO_ERRORS)),
            covariance=np.zeros((n, SERVO_ERRORS, SERVO_ERRORS)),
            work=np.zeros((2, SERVO_ERRORS)),
            steps=np.zeros(1),
        )
        functions = begin_servo, servo_step, servo_stop
        super().__init__(parameters, state, functions, horizon, needed, dt)


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
