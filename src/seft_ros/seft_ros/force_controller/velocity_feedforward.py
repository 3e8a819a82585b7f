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
from seft_msgs_py.wire.topics import RigAxes, Timebase
from seft_plant_sim.judge.known_rig import ASSUMED_ACTUATOR, known_actuators, read_specimen
from seft_plant_sim.judge.valve_following import VALVE_ERRORS, doubt
from seft_plant_sim.judge.valve_model import valve_models

from seft_ros.force_controller.feedforward_step import (
    FeedforwardParameters,
    FeedforwardState,
    begin_feedforward,
    feedforward_step,
    feedforward_stop,
)
from seft_ros.force_controller.force_controller_parameters import VELOCITY_FEEDFORWARD
from seft_ros.force_controller.oil_column import regulator
from seft_ros.force_controller.target_follower import TargetFollower, horizon_of
from seft_ros.reference_force.observers import observer_gains, sensor_noise

BETWEEN = 1.0
"""Of the observer, see `observer_gains`. The feedback is slower than what accelerations leave out
between the samples, and displacement noise that it passes on rings the oil."""


class VelocityFeedforward(TargetFollower):
    """Force controller of n axes that opens the valves for the future motion.

    Its errors are those of the flow gain (relative), the delay (s), and the oil (relative).

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
        If the actuators are not known, or the horizon is too short for the valves.
    """

    method = VELOCITY_FEEDFORWARD
    names = "flow_gain_error", "delay_error", "oil_compliance_error"

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
        valves = valve_models(known, dt)
        n, needed = len(valves), max(valve.taps() for valve in valves)
        horizon = horizon_of(section, dt, needed + 1, "valves")
        memory, past = valves[0].memory, max(valve.past() for valve in valves)
        inverse = np.array([valve.inverse(needed, past) for valve in valves])
        mass, stiffness = read_specimen(section, axes, own)
        feedback, sent = regulator(valves, actuator[:, 1:3], mass, stiffness, memory, dt)
        # of planned flows: the inverse, and the feedback of the commands that it makes of them
        planned = np.zeros((n, n, memory + past + needed))
        for i, k in np.ndindex(n, n):
            planned[i, k, :-1] = np.convolve(sent[i, k, ::-1], inverse[k])
        planned[range(n), range(n), memory:] += inverse
        delay = np.array([valve.delay for valve in valves])
        gains, left = observer_gains(noise, dt, BETWEEN)
        parameters = FeedforwardParameters(
            dt=dt,
            limit=section["limits.command"],
            gains=gains,
            actuator=np.ascontiguousarray(actuator),
            friction=np.column_stack([known["friction"], 1.0 / known["friction_velocity"]]),
            feedback=feedback,
            sent=sent,
            planned=planned,
            past=np.array([valve.last_period() for valve in valves]),
            doubt=doubt(left[1], noise[3], actuator[:, 1], delay, dt),
            smoothing=1.0 - np.exp(-dt / delay),
        )
        state = FeedforwardState(
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
            sample=np.zeros((4, n)),
            steps=np.zeros(1),
        )
        functions = begin_feedforward, feedforward_step, feedforward_stop
        super().__init__(parameters, state, functions, horizon, needed + 1, dt)
