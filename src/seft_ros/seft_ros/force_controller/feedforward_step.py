"""The steps of `VelocityFeedforward`: the flow that a plan needs, and the way back to the plan."""

from typing import NamedTuple

from seft_msgs_py.arrays import Floats
from seft_plant_sim.compiled import compiled, put_first, smooth_sign
from seft_plant_sim.judge.valve_following import begin_following, follow_valve, under_load

from seft_ros.protection.protection_step import as_sample, planned_acceleration, slow_down
from seft_ros.reference_force.observers import observe


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
        Flow per planned flow, of the past and then of the future: the inverse of the valve, and
        ``sent`` times the commands that the inverse makes of them; shape (n, n, known + taps).
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


class FeedforwardState(NamedTuple):
    """State of the controller.

    Attributes
    ----------
    measured : ndarray
        See `observe`, shape (3, n).
    last : ndarray
        Last displacement (m) and force of the oil (N), shape (n, 2).
    sent : ndarray
        Past commands, the newest first, shape (n, memory), V.
    flows : ndarray
        Past planned flows, the newest first, shape (n, known), m/s.
    flow, coming : ndarray
        Planned flows from this step on, and the same for the delay as estimated, m/s; shapes
        (taps + 1,) and (n, taps).
    signals, work : ndarray
        See `follow_valve`, shapes (n, 4) and (3,).
    errors, covariance : ndarray
        Of the valves and their oil, see `follow_valve`; shapes (n, 3) and (n, 3, 3).
    sample : ndarray
        Room for a sample, shape (4, n).
    steps : ndarray
        Samples taken, shape (1,).
    """

    measured: Floats
    last: Floats
    sent: Floats
    flows: Floats
    flow: Floats
    coming: Floats
    signals: Floats
    work: Floats
    errors: Floats
    covariance: Floats
    sample: Floats
    steps: Floats


GAIN_ERROR, DELAY_ERROR, OIL_ERROR = range(3)
"""Columns of ``errors``."""


@compiled
def begin_feedforward(state: FeedforwardState) -> None:
    """Begin a test with the assumed valves."""
    state.measured[:] = 0.0
    state.last[:] = 0.0
    state.sent[:] = 0.0
    state.flows[:] = 0.0
    state.signals[:] = 0.0
    state.steps[0] = 0.0
    begin_following(state.errors, state.covariance)


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
        drive /= p.actuator[i, 0] * (1.0 + state.errors[i, GAIN_ERROR])
        if abs(drive) >= p.limit:
            limited = True
            drive = p.limit if drive > 0.0 else -p.limit
        command[i] = drive
    for i in range(n):
        put_first(state.sent[i], command[i])
        put_first(state.flows[i], state.coming[i, 0])
    state.steps[0] += 1.0
    return limited


@compiled
def _plan(p: FeedforwardParameters, state: FeedforwardState, i: int, points: Floats) -> None:
    """Find the flow of a valve for a planned motion, as an opening without load: Eq. (4)."""
    flow, coming, taps = state.flow, state.coming[i], state.coming.shape[1]
    leakage, capacity = p.actuator[i, 2], p.actuator[i, 3]
    compliance = (1.0 + state.errors[i, OIL_ERROR]) / p.actuator[i, 1]
    then = points[0, 2, i] + _rubs(p, i, points[0, 1, i])
    for j in range(taps + 1):
        moved = points[j + 1, 0, i] - points[j, 0, i]
        now, then = then, points[j + 1, 2, i] + _rubs(p, i, points[j + 1, 1, i])
        rise, mean = then - now, 0.5 * (now + then)
        needed = (moved + compliance * (rise + p.dt * leakage * mean)) / p.dt
        flow[j] = needed / under_load(needed, mean, capacity)
    late = state.errors[i, DELAY_ERROR]
    for j in range(taps):
        before = max(j - 1, 0)
        coming[j] = flow[j] + late * (flow[j + 1] - flow[before]) / ((j + 1 - before) * p.dt)


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
    flow += feedback[2, k] * (planned_acceleration(points, k, p.dt) - state.measured[2, k])
    flow += feedback[3, k] * (points[0, 2, k] - force) / p.actuator[k, 1]
    for j in range(state.coming.shape[1]):
        flow += planned[known + j] * state.coming[k, j]
    for j in range(known):
        flow += planned[known - 1 - j] * state.flows[k, j]
    sent, gain = 0.0, p.actuator[k, 0] * (1.0 + state.errors[k, GAIN_ERROR])
    for j in range(state.sent.shape[1]):
        sent += p.sent[i, k, j] * state.sent[k, j]
    return flow - gain * sent


@compiled
def _follow(p: FeedforwardParameters, state: FeedforwardState, i: int, force: float) -> None:
    """Estimate the errors of a valve and its oil from the last period, see `valve_following`."""
    gain, oil, leakage = p.actuator[i, 0], p.actuator[i, 1], p.actuator[i, 2]
    signals, last, x = state.signals[i], state.last[i], state.measured[0, i]
    force += _rubs(p, i, state.measured[1, i])
    if state.steps[0] >= state.sent.shape[1]:  # all commands under way are known
        flow = later = 0.0
        for j in range(state.sent.shape[1]):
            flow += p.past[i, 0, j] * state.sent[i, j]
            later += p.past[i, 1, j] * state.sent[i, j]
        mean, smoothing = 0.5 * (force + last[1]), p.smoothing[i]
        passed = gain * under_load(flow, mean, p.actuator[i, 3])
        squeezed = ((force - last[1]) / p.dt + leakage * mean) / oil
        signals[0] += smoothing * (passed * flow - signals[0])
        signals[1] += smoothing * (passed * later - signals[1])
        signals[2] += smoothing * (-squeezed - signals[2])
        signals[3] += smoothing * ((x - last[0]) / p.dt - signals[3])
        follow_valve(state.errors[i], state.covariance[i], signals, p.doubt[i], state.work)
    last[0], last[1] = x, force


@compiled
def feedforward_stop(
    parameters: FeedforwardParameters,
    state: FeedforwardState,
    plan: Floats,
    slowed: Floats,
    commands: Floats,
) -> None:
    """Find the commands that bring the rig to rest along a plan.

    Parameters
    ----------
    parameters, state
        See `feedforward_step`; the state is used up.
    plan, slowed : ndarray
        See `slow_down`; the second is room of shape (N + taps + 2, 3, n). The slowed target takes
        the place of samples.
    commands : ndarray
        From the step after that of the plan on, shape (N, n), V. The result.
    """
    slow_down(plan, len(commands), parameters.dt, slowed)
    for j in range(len(commands)):
        points = slowed[j + 1 :]
        as_sample(points, parameters.dt, state.sample)
        feedforward_step(parameters, state, points, state.sample, commands[j])
