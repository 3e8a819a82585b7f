"""Force control by the motion of the target: the valve determines the piston's velocity.

The oil obeys f' = k_oil (q w - v) - lambda f, with the valve's flow w. So over a period, the volume
for a planned motion x* and force f* of the oil, that of the load cell and the piston's friction, is

    integral of q w = change of x* + (change of f* + integral of lambda f*) / k_oil         (4)

for any specimen: this is the velocity feedback compensation of effective force testing (Dimig et
al. 1999) with the future motion of the structure. A loaded valve passes less oil, by the root of
the remaining part of the supply pressure (Merritt 1967). The valve's own response is inverted
(`ValveModel.inverse`).

What is left of the deviation from the plan is brought back by the `regulator` of the rig's model,
Eq. (5). Gain and delay of the valve, and the stiffness of its oil, are followed on the measured
Eq. (4), see `valve_following`.
"""

from typing import Annotated, NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats, zeros
from seft_msgs_py.config.parameter_table import Section
from seft_plant_sim.compiled import bounded, compiled, dot, put_first, smooth_sign
from seft_plant_sim.judge import known_rig, valve_following
from seft_plant_sim.judge.known_rig import CAPACITY, FLOW_GAIN, LEAKAGE, OIL_STIFFNESS
from seft_plant_sim.judge.valve_following import VALVE_ERRORS, follow_valve, under_load
from seft_plant_sim.judge.valve_model import valve_models

from seft_ros.force_controller import force_control
from seft_ros.force_controller.force_control import DELAY_ERROR, GAIN_ERROR, TargetFollower
from seft_ros.force_controller.force_controller_parameters import VELOCITY_FEEDFORWARD
from seft_ros.force_controller.oil_column import regulator
from seft_ros.force_controller.stop_path import StopPath, path_to_rest, planned_acceleration
from seft_ros.reference_force.observers import observe, observer_gains, sensor_noise


class FeedforwardParameters(NamedTuple):
    """Parameters of a controller of n valves.

    Attributes
    ----------
    dt, limit : float
        Sampling period, s, and largest command, V.
    gains : ndarray
        Of the observer, shape (n, 2, 2).
    actuator : ndarray
        Flow gain (m/s/V), oil stiffness (N/m), leakage (1/s) and force capacity (N) of each axis,
        shape (n, 4).
    friction : ndarray
        Coulomb friction of each piston (N), and 1 / the velocity over which it builds up (s/m),
        shape (n, 2).
    feedback : ndarray
        Flow per deviation of displacement, velocity, acceleration and compression, see
        `regulator`; shape (n, 4, n).
    sent : ndarray
        Flow per deviation of past commands, the newest first, shape (n, n, memory).
    planned : ndarray
        Flow per planned flow, of the past, the newest first, and then of the future: the inverse
        of the valve, and ``sent`` times the commands that the inverse makes of them; shape
        (n, n, known + taps).
    past : ndarray
        Of past commands, the newest first: mean flow in the last period, and its change per delay,
        1/s; shape (n, 2, memory).
    doubt : ndarray
        Variance of the measured Eq. (4), shape (n,), (m/s)^2.
    smoothing : ndarray
        Factor of the low pass of `valve_following`, shape (n,).
    """

    dt: float
    limit: float
    gains: Floats
    actuator: Floats
    friction: Floats
    feedback: Floats
    sent: Floats
    planned: Floats
    past: Floats
    doubt: Floats
    smoothing: Floats


OIL_ERROR = 2
"""Column of ``errors`` after `GAIN_ERROR` and `DELAY_ERROR`."""


class FeedforwardState(NamedTuple):
    """State of the controller: arrays of zeros, but for ``covariance``."""

    measured: Annotated[Floats, 3, "n"]  # see `observe`
    last: Annotated[Floats, "n", 2]  # last displacement, m, and force of the oil, N
    sent: Annotated[Floats, "n", "memory"]  # past commands, the newest first, V
    flows: Annotated[Floats, "n", "known"]  # past planned flows, the newest first, m/s
    flow: Annotated[Floats, "needed"]  # planned flows from this step on, m/s
    coming: Annotated[Floats, "n", "taps"]  # the same for the delay as estimated
    signals: Annotated[Floats, "n", VALVE_ERRORS + 1]  # see `follow_valve`
    work: Annotated[Floats, VALVE_ERRORS]
    errors: Annotated[Floats, "n", VALVE_ERRORS]  # of the valves and their oil
    covariance: Annotated[Floats, "n", VALVE_ERRORS, VALVE_ERRORS]
    sample: Annotated[Floats, 4, "n"]  # room
    steps: Annotated[Floats, 1]  # samples taken


@compiled
def feedforward_step(
    parameters: FeedforwardParameters,
    state: FeedforwardState,
    points: Floats,
    measured: Floats,
    command: Floats,
) -> bool:
    """Find the valve commands that answer a sample.

    Parameters
    ----------
    parameters, state
        The state is updated.
    points : ndarray
        Displacement, velocity and force of the target at this step and the future ones, shape
        (taps + 2 or more, 3, n).
    measured : ndarray
        Displacement, velocity, acceleration and force, shape (4, n).
    command : ndarray
        The result, shape (n,), V.

    Returns
    -------
    bool
        Whether one of them is at its limit.
    """
    p, n, limited = parameters, len(command), False
    observe(p.gains, p.dt, state.steps[0] == 0.0, measured, state.measured)
    for i in range(n):
        _follow(p, state, i, measured[3, i])
        _plan(p, state, i, points)
    for i in range(n):
        drive = 0.0
        for k in range(n):
            drive += _flow_by(p, state, points, measured[3, k], i, k)
        drive /= p.actuator[i, FLOW_GAIN] * (1.0 + state.errors[i, GAIN_ERROR])
        limited |= abs(drive) >= p.limit
        command[i] = bounded(drive, p.limit)
    for i in range(n):
        put_first(state.sent[i], command[i])
        put_first(state.flows[i], state.coming[i, 0])
    state.steps[0] += 1.0
    return limited


@compiled
def _plan(p: FeedforwardParameters, state: FeedforwardState, i: int, points: Floats) -> None:
    """Find the flow of a valve for a planned motion, as an opening without load: Eq. (4)."""
    flow, coming, taps = state.flow, state.coming[i], state.coming.shape[1]
    leaked, capacity = p.dt * p.actuator[i, LEAKAGE], p.actuator[i, CAPACITY]
    per_period = 1.0 / p.dt
    compliance = (1.0 + state.errors[i, OIL_ERROR]) / p.actuator[i, OIL_STIFFNESS]
    then = points[0, 2, i] + _rubs(p, i, points[0, 1, i])
    for j in range(taps + 1):
        moved = points[j + 1, 0, i] - points[j, 0, i]
        now, then = then, points[j + 1, 2, i] + _rubs(p, i, points[j + 1, 1, i])
        rise, mean = then - now, 0.5 * (now + then)
        needed = (moved + compliance * (rise + leaked * mean)) * per_period
        flow[j] = needed / under_load(needed, mean, capacity)
    late = state.errors[i, DELAY_ERROR] / p.dt
    coming[0] = flow[0] + late * (flow[1] - flow[0])
    for j in range(1, taps):
        coming[j] = flow[j] + 0.5 * late * (flow[j + 1] - flow[j - 1])


@compiled
def _rubs(p: FeedforwardParameters, i: int, velocity: float) -> float:
    """Friction of a piston, N: the force of the oil beyond that of the load cell."""
    friction = p.friction[i, 0]
    return friction * smooth_sign(velocity * p.friction[i, 1]) if friction else 0.0


@compiled
def _flow_by(
    p: FeedforwardParameters, state: FeedforwardState, points: Floats, force: float, i: int, k: int
) -> float:
    """Flow of valve i for the planned flows of axis k, and for its deviation from the plan."""
    known, feedback, planned = state.flows.shape[1], p.feedback[i], p.planned[i, k]
    flow = feedback[0, k] * (points[0, 0, k] - state.measured[0, k])
    flow += feedback[1, k] * (points[0, 1, k] - state.measured[1, k])
    wanted = planned_acceleration(points, k, p.dt)
    flow += feedback[2, k] * (wanted - state.measured[2, k])
    flow += feedback[3, k] * (points[0, 2, k] - force) / p.actuator[k, OIL_STIFFNESS]
    flow += dot(state.coming.shape[1], planned[known:], state.coming[k])
    flow += dot(known, planned, state.flows[k])
    gain = p.actuator[k, FLOW_GAIN] * (1.0 + state.errors[k, GAIN_ERROR])
    return flow - gain * dot(state.sent.shape[1], p.sent[i, k], state.sent[k])


@compiled
def _follow(p: FeedforwardParameters, state: FeedforwardState, i: int, force: float) -> None:
    """Estimate the errors of a valve and its oil from the last period, see `valve_following`."""
    actuator, last, x = p.actuator[i], state.last[i], state.measured[0, i]
    gain, oil, leakage = actuator[FLOW_GAIN], actuator[OIL_STIFFNESS], actuator[LEAKAGE]
    signals = state.signals[i]
    force += _rubs(p, i, state.measured[1, i])
    if state.steps[0] >= state.sent.shape[1]:  # all commands under way are known
        flow = dot(state.sent.shape[1], p.past[i, 0], state.sent[i])
        later = dot(state.sent.shape[1], p.past[i, 1], state.sent[i])
        mean, smoothing, per_period = 0.5 * (force + last[1]), p.smoothing[i], 1.0 / p.dt
        passed = gain * under_load(flow, mean, actuator[CAPACITY])
        squeezed = ((force - last[1]) * per_period + leakage * mean) / oil
        signals[0] += smoothing * (passed * flow - signals[0])
        signals[1] += smoothing * (passed * later - signals[1])
        signals[2] += smoothing * (-squeezed - signals[2])
        signals[3] += smoothing * ((x - last[0]) * per_period - signals[3])
        follow_valve(state.errors[i], state.covariance[i], signals, p.doubt[i], state.work)
    last[0], last[1] = x, force


@compiled
def feedforward_stop(
    parameters: FeedforwardParameters,
    state: FeedforwardState,
    stop: StopPath,
    plan: Floats,
    path: Floats,
    commands: Floats,
) -> None:
    """Find the commands that bring the rig to rest along a plan.

    Parameters
    ----------
    parameters, state
        See `feedforward_step`; the state is used up.
    stop, plan, path
        See `path_to_rest`; the last is room of shape (N + taps + 2, 3, n). The path takes the place
        of samples.
    commands : ndarray
        From the step after that of the plan on, shape (N, n), V. The result.
    """
    path_to_rest(stop, plan, path)
    for j in range(len(commands)):
        points = path[j + 1 :]
        force_control.as_sample(points, parameters.dt, state.sample)
        feedforward_step(parameters, state, points, state.sample, commands[j])


BETWEEN = 0.6
"""Of the observer, see `observer_gains`. The feedback is slower than what accelerations leave out
between the samples, and displacement noise that it passes on rings the oil: an estimate of the
displacement that is a fifth noisier, but smoother, makes a sixth less of the force's error."""


class VelocityFeedforward(TargetFollower):
    """Force controller of n axes that opens the valves for the future motion.

    Its errors are those of the flow gain (relative), the delay (s), and the oil (relative). The
    actuators must be known.
    """

    method = VELOCITY_FEEDFORWARD
    names = "flow_gain_error", "delay_error", "oil_compliance_error"
    uncertain = valve_following.UNCERTAIN_VALVE
    functions = feedforward_step, feedforward_stop

    def _known(
        self, section: Section, axes: tuple[str, ...], own: list[int], dt: float
    ) -> tuple[FeedforwardParameters, FeedforwardState, int, int]:
        known = known_rig.known_actuators(section, axes, own)
        actuator = np.transpose([known[name] for name in known_rig.ASSUMED_ACTUATOR])
        noise = sensor_noise(section, axes)[:, own]
        valves = valve_models(known, dt)
        n, needed = len(valves), max(valve.taps() for valve in valves)
        horizon = force_control.horizon_of(section, dt, needed + 1, "valves")
        memory, past = valves[0].memory, max(valve.past() for valve in valves)
        inverse = np.array([valve.inverse(needed, past) for valve in valves])
        specimen = known_rig.read_specimen(section, axes, own)
        feedback, sent = regulator(valves, actuator[:, 1:3], *specimen, memory, dt)
        # of planned flows: the inverse, and the feedback of the commands that it makes of them
        planned = np.zeros((n, n, memory + past + needed))
        for i, k in np.ndindex(n, n):
            planned[i, k, :-1] = np.convolve(sent[i, k, ::-1], inverse[k])
        planned[range(n), range(n), memory:] += inverse
        known_flows = memory + past
        planned[:, :, :known_flows] = planned[:, :, :known_flows][:, :, ::-1].copy()
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
            doubt=valve_following.doubt(left[1], noise[3], actuator[:, OIL_STIFFNESS], delay, dt),
            smoothing=1.0 - np.exp(-dt / delay),
        )
        sizes = {"n": n, "memory": memory, "known": known_flows}
        state = zeros(FeedforwardState, sizes | {"taps": needed, "needed": needed + 1})
        return parameters, state, horizon, needed + 1
