"""Force control by the motion of the target: the valve determines the piston's velocity.

The oil obeys f' = k_oil (q w - v) - lambda f, with the valve's flow w. So over a period, the volume
for a planned motion x* and force f* is

    integral of q w = change of x* + (change of f* + integral of lambda f*) / k_oil         (4)

for any specimen: this is the velocity feedback compensation of effective force testing (Dimig et
al. 1999) with the future motion of the structure. A loaded valve passes less oil, by the root of
the remaining part of the supply pressure (Merritt 1967). The valve's own response is inverted
(`ValveModel.inverse`).

What is left of the deviation from the plan is brought back by the `regulator` of the rig's model,
Eq. (5). Gain and delay of the valve, and the stiffness of its oil, are followed on the measured
Eq. (4), see `valve_following`.
"""

from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import RigAxes, Timebase
from seft_plant_sim.compiled import entry_point
from seft_plant_sim.judge.known_rig import ASSUMED_ACTUATOR, known_actuators, read_specimen
from seft_plant_sim.judge.valve_following import VALVE_ERRORS, doubt
from seft_plant_sim.judge.valve_model import valve_models
from seft_plant_sim.rig_parameters import common_lag

from seft_ros.force_controller.feedforward_step import (
    FeedforwardParameters,
    FeedforwardState,
    begin_feedforward,
    feedforward_step,
    feedforward_stop,
)
from seft_ros.force_controller.force_control import LinearControl
from seft_ros.force_controller.force_controller_parameters import VELOCITY_FEEDFORWARD
from seft_ros.force_controller.oil_column import regulator
from seft_ros.protection.protection_step import stop_steps
from seft_ros.reference_force.compensator import NotLinearError
from seft_ros.reference_force.observers import observer_gains, sensor_noise
from seft_ros.reference_force.reference_force_parameters import HORIZON_PER_LAG, horizon_steps

BETWEEN = 1.0
"""Of the observer, see `observer_gains`. The feedback is slower than what accelerations leave out
between the samples, and displacement noise that it passes on rings the oil."""


class VelocityFeedforward:
    """Force controller of n axes that opens the valves for the future motion.

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

    Attributes
    ----------
    limited, shape
        See `ForceControl`.
    parameters, state
        Arguments of `feedforward_step`, here and in a compiled loop.

    Raises
    ------
    InputError
        If the actuators are not known, or the horizon is too short for the valves.
    """

    def __init__(
        self,
        section: dict[str, Any],
        axes: tuple[str, ...],
        timebase: Timebase,
        rig: RigAxes | None = None,
    ) -> None:
        own, dt = list((rig or RigAxes.whole(axes)).places), timebase.dt
        known = known_actuators(section, axes, own)
        actuator = np.transpose([known[name] for name in ASSUMED_ACTUATOR])
        noise = sensor_noise(section, axes)[:, own]
        horizon = horizon_steps(section, dt)
        valves = valve_models(known, dt)
        n, needed = len(valves), max(valve.taps() for valve in valves)
        if horizon < needed + 1:
            needs = (needed + 1) * dt - HORIZON_PER_LAG * common_lag(section)
            raise InputError(
                f"reference_force: compensation.horizon is {section['compensation.horizon']:g} s, "
                f"but the valves need {needs:g} s of the future motion; make it longer"
            )
        memory, past = valves[0].memory, max(valve.past() for valve in valves)
        inverse = np.array([valve.inverse(needed, past) for valve in valves])
        mass, stiffness, _ = read_specimen(section, axes, own)
        feedback, sent = regulator(valves, actuator[:, 1:3], mass, stiffness, memory, dt)
        # of planned flows: the inverse, and the feedback of the commands that it makes of them
        planned = np.zeros((n, n, memory + past + needed))
        for i, k in np.ndindex(n, n):
            planned[i, k, :-1] = np.convolve(sent[i, k, ::-1], inverse[k])
        planned[range(n), range(n), memory:] += inverse
        delay = np.array([valve.delay for valve in valves])
        gains, left = observer_gains(noise, dt, BETWEEN)
        self.parameters = FeedforwardParameters(
            dt=dt,
            limit=section["limits.command"],
            gains=gains,
            actuator=np.ascontiguousarray(actuator),
            feedback=feedback,
            sent=sent,
            planned=planned,
            past=np.array([valve.last_period() for valve in valves]),
            doubt=doubt(left[1], noise[3], actuator[:, 1], delay, dt),
            smoothing=1.0 - np.exp(-dt / delay),
        )
        self.state = FeedforwardState(
            measured=np.zeros((3, n)),
            last=np.zeros((n, 2)),
            sent=np.zeros((n, memory)),
            flows=np.zeros((n, memory + past)),
            flow=np.zeros(needed + 1),
            coming=np.zeros((n, needed)),
            signals=np.zeros((n, VALVE_ERRORS + 1)),
            work=np.zeros(VALVE_ERRORS),
            errors=np.zeros((n, VALVE_ERRORS)),
            covariance=np.zeros((n, VALVE_ERRORS, VALVE_ERRORS)),
            steps=np.zeros(1),
        )
        self.shape = 1 + horizon, 3
        self._points, self._measured = np.zeros((1 + horizon, 3, n)), np.zeros((4, n))
        self._command, both = np.zeros(n), (self.parameters, self.state)
        arguments = self._points, self._measured, self._command
        self._step = entry_point(feedforward_step, *both, *arguments)
        steps = stop_steps(1 + horizon, dt)
        slowed = np.zeros((steps + needed + 2, 3, n))
        self._room = slowed, np.zeros((4, n)), np.zeros((steps, n))
        self._used_up = FeedforwardState(*(np.zeros_like(each) for each in self.state))
        self._stop = entry_point(feedforward_stop, *both, self._points, *self._room)
        self._begin = entry_point(begin_feedforward, self.state)
        self.reset()

    def reset(self) -> None:
        """Begin a new test."""
        self.limited = False
        self._begin(self.state)

    def estimates(self) -> dict[str, Floats]:
        """Relative error of the flow gain, error of the delay (s), relative error of the oil."""
        names = "flow_gain_error", "delay_error", "oil_compliance_error"
        return dict(zip(names, self.state.errors.T, strict=True))

    def linear(self) -> LinearControl:
        """Raise an error: there is none."""
        raise NotLinearError("force_controller", VELOCITY_FEEDFORWARD)

    def step(self, points: Floats, state: Floats) -> Floats:
        """Find the valve commands that answer a sample, see `feedforward_step`; (n,), V."""
        known = points[: len(self._points)]
        self._points[: len(known)], self._points[len(known) :] = known, known[-1]
        self._measured[:] = state
        self.limited = self._step(
            self.parameters, self.state, self._points, self._measured, self._command
        )
        return self._command.copy()

    def stop(self, plan: Floats) -> Floats:
        """Give the commands that bring the rig to rest, from the next step on; (N, n), V.

        ``plan`` has the target's points of the last step and the coming ones, shape `shape` and n.
        """
        for used, own in zip(self._used_up, self.state, strict=True):
            used[...] = own
        self._stop(self.parameters, self._used_up, plan, *self._room)
        return self._room[-1].copy()
