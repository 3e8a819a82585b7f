"""Force control by the motion of the target: the valve determines the piston's velocity.

The oil obeys f' = k_oil (q w - v) - lambda f, with the valve's flow w. So the flow for a future
motion v* and force f* is

    q w = v* + (f*' + lambda f*) / k_oil                                                    (4)

for any specimen: this is the velocity feedback compensation of effective force testing (Dimig et
al. 1999) with the future velocity of the structure. A loaded valve passes less oil, by the root of
the remaining part of the supply pressure (Merritt 1967). The valve's own response is inverted
(`ValveModel.inverse`).

The remaining error is fed back as oil volume: between the piston's position after all past commands
have taken effect, and the target's position at that time (a Smith predictor)::

    e = x* - x + volume of the future flow - volume of the commands under way               (5)

Gain and delay of the valve are estimated by recursive least squares on the measured Eq. (4).
"""

import math
from typing import Any, NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import RigAxes, Timebase
from seft_plant_sim.compiled import compiled, entry_point

from seft_ros.force_controller.force_control import LinearControl
from seft_ros.force_controller.force_controller_parameters import VELOCITY_FEEDFORWARD
from seft_ros.force_controller.valve_model import ASSUMED_ACTUATOR, read_actuators, valve_models
from seft_ros.protection.protection_step import as_sample, slow_down, stop_steps
from seft_ros.protection.valve_following import begin_following, doubt, follow_valve, under_load
from seft_ros.reference_force.compensator import NotLinearError
from seft_ros.reference_force.observers import observe, observer_gains, sensor_noise
from seft_ros.reference_force.reference_force_parameters import HORIZON_PER_LAG, horizon_steps

FEEDBACK = math.pi / 8
"""Gain of the feedback times the valve's mean delay: a quarter of the value that would oscillate
without the prediction of Eq. (5)."""
BEGIN = 10
"""Samples before the estimation begins: the valve's model must know the commands under way."""


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
    feedback : ndarray
        1/s, shape (n,).
    inverse : ndarray
        Weights of this and the future flows, shape (n, taps).
    future : ndarray
        Volume per flow that is under way when the flow begins, s; first of past, then of future
        flows, shape (n, memory + taps).
    in_flight, past, later : ndarray
        Of past commands: volume still to come, s, present flow, and its change per delay, 1/s; the
        newest first, shape (n, memory).
    doubt : ndarray
        Variance of the measured Eq. (4), shape (n,), (m/s)^2.
    """

    dt: float
    limit: float
    gains: Floats
    actuator: Floats
    feedback: Floats
    inverse: Floats
    future: Floats
    in_flight: Floats
    past: Floats
    later: Floats
    doubt: Floats


class FeedforwardState(NamedTuple):
    """State of the controller.

    Attributes
    ----------
    measured : ndarray
        See `observe`, shape (3, n).
    force : ndarray
        Last measured force, shape (n,).
    sent : ndarray
        Past commands as they act under load, the newest first, shape (n, memory), V.
    flows : ndarray
        Past flows of the target, the newest first, shape (n, memory), m/s.
    flow, shifted : ndarray
        Work arrays for the future flows, shape (h + 1,).
    errors : ndarray
        Relative error of the flow gain and error of the delay in s, shape (n, 2).
    covariance : ndarray
        Of these: variances, then the covariance; shape (n, 3).
    steps : ndarray
        Samples taken, shape (1,).
    """

    measured: Floats
    force: Floats
    sent: Floats
    flows: Floats
    flow: Floats
    shifted: Floats
    errors: Floats
    covariance: Floats
    steps: Floats


@compiled
def begin_feedforward(parameters: FeedforwardParameters, state: FeedforwardState) -> None:
    """Begin a test with the assumed valves."""
    state.measured[:] = 0.0
    state.force[:] = 0.0
    state.sent[:] = 0.0
    state.flows[:] = 0.0
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
        (taps + 1 or more, 3, n).
    measured : ndarray
        Displacement, velocity, acceleration and force, shape (4, n).
    command : ndarray
        The result, shape (n,), V.

    Returns
    -------
    bool
        Whether one of them is at its limit.
    """
    p, taps, limited = parameters, parameters.inverse.shape[1], False
    memory = state.sent.shape[1]
    observe(p.gains, p.dt, state.steps[0] == 0.0, measured, state.measured)
    flow, shifted = state.flow, state.shifted
    for i in range(len(command)):
        gain, oil, leakage = p.actuator[i, 0], p.actuator[i, 1], p.actuator[i, 2]
        capacity, force = p.actuator[i, 3], measured[3, i]
        for j in range(taps + 1):
            # Eq. (4)
            before, after = max(j - 1, 0), min(j + 1, taps)
            rise = (points[after, 2, i] - points[before, 2, i]) / ((after - before) * p.dt)
            needed = points[j, 1, i] + (rise + leakage * points[j, 2, i]) / oil
            flow[j] = needed / under_load(needed, points[j, 2, i], capacity)
        if state.steps[0] >= BEGIN:
            _follow(p, state, i, force)
        late = state.errors[i, 1]
        for j in range(taps):
            before = max(j - 1, 0)
            span = (j + 1 - before) * p.dt
            shifted[j] = flow[j] + late * (flow[j + 1] - flow[before]) / span
        real = gain * (1.0 + state.errors[i, 0])
        # Eq. (5)
        error = points[0, 0, i] - state.measured[0, i]
        drive = 0.0
        for j in range(taps):
            drive += p.inverse[i, j] * shifted[j]
            error += p.future[i, memory + j] * shifted[j]
        for j in range(memory):
            error += p.future[i, memory - 1 - j] * state.flows[i, j]
        for j in range(memory):
            error -= p.in_flight[i, j] * real * state.sent[i, j]
        drive = (drive + p.feedback[i] * error) / real
        if abs(drive) >= p.limit:
            limited = True
            drive = p.limit if drive > 0.0 else -p.limit
        command[i] = drive
        for j in range(memory - 1, 0, -1):
            state.sent[i, j] = state.sent[i, j - 1]
            state.flows[i, j] = state.flows[i, j - 1]
        state.sent[i, 0] = drive * under_load(drive, force, capacity)
        state.flows[i, 0] = shifted[0]
        state.force[i] = force
    state.steps[0] += 1.0
    return limited


@compiled
def _follow(p: FeedforwardParameters, state: FeedforwardState, i: int, force: float) -> None:
    """Estimate gain and delay of a valve by Eq. (4), from the measured flow and the model's."""
    gain, oil, leakage = p.actuator[i, 0], p.actuator[i, 1], p.actuator[i, 2]
    rise = (force - state.force[i]) / p.dt
    seen = state.measured[1, i] + (rise + leakage * force) / oil
    flow = later = 0.0
    for j in range(state.sent.shape[1]):
        flow += p.past[i, j] * state.sent[i, j]
        later += p.later[i, j] * state.sent[i, j]
    follow_valve(state.errors[i], state.covariance[i], gain * flow, gain * later, seen, p.doubt[i])


@compiled
def feedforward_stop(
    parameters: FeedforwardParameters,
    state: FeedforwardState,
    plan: Floats,
    slowed: Floats,
    sample: Floats,
    commands: Floats,
) -> None:
    """Find the commands that bring the rig to rest along a plan.

    Parameters
    ----------
    parameters, state
        See `feedforward_step`; the state is used up.
    plan, slowed : ndarray
        See `slow_down`; the second is room of shape (N + taps + 2, 3, n).
    sample : ndarray
        Room, shape (4, n): the slowed target takes the place of samples.
    commands : ndarray
        From the step after that of the plan on, shape (N, n), V. The result.
    """
    slow_down(plan, len(commands), slowed)
    for j in range(len(commands)):
        points = slowed[j + 1 :]
        as_sample(points, parameters.dt, sample)
        feedforward_step(parameters, state, points, sample, commands[j])


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
        known = self.actuator(section, axes, rig)
        actuator = np.transpose([known[name] for name in ASSUMED_ACTUATOR])
        noise = sensor_noise(section, axes, "noise", "force_controller")[:, own]
        more = HORIZON_PER_LAG * section["sensor_lag"]
        horizon = horizon_steps(section["horizon"], section["sensor_lag"], dt)
        valves = valve_models(known, dt)
        n, needed = len(valves), max(valve.taps() for valve in valves)
        if horizon < needed + 1:
            raise InputError(
                f"force_controller: the valves need {(needed + 1) * dt - more:g} s of the future "
                f"motion, but reference_force: compensation.horizon is {section['horizon']:g} s; "
                "make it longer"
            )
        memory = valves[0].memory
        inverse = np.array([valve.inverse(needed) for valve in valves])
        in_flight = dt * np.array([valve.in_flight() for valve in valves])
        # volume under way of the commands that the inverse makes from the flows: their convolution
        future = np.zeros((n, memory + needed))
        for row, own, h in zip(future, in_flight, inverse, strict=True):
            row[:-1] = np.convolve(own[::-1], h)
        self.parameters = FeedforwardParameters(
            dt=dt,
            limit=section["voltage_limit"],
            gains=observer_gains(noise, dt)[0],
            actuator=np.ascontiguousarray(actuator),
            feedback=np.array([FEEDBACK / valve.delay for valve in valves]),
            inverse=inverse,
            future=future,
            in_flight=in_flight,
            past=np.array([valve.past() for valve in valves]),
            later=np.array([valve.later() for valve in valves]),
            doubt=doubt(noise[1], noise[3], actuator[:, 1], dt),
        )
        self.state = FeedforwardState(
            measured=np.zeros((3, n)),
            force=np.zeros(n),
            sent=np.zeros((n, memory)),
            flows=np.zeros((n, memory)),
            flow=np.zeros(needed + 1),
            shifted=np.zeros(needed + 1),
            errors=np.zeros((n, 2)),
            covariance=np.zeros((n, 3)),
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
        self._begin = entry_point(begin_feedforward, *both)
        self.reset()

    @staticmethod
    def actuator(
        section: dict[str, Any], axes: tuple[str, ...], rig: RigAxes | None = None
    ) -> dict[str, Floats]:
        """Give each actuator's parameters from a section, by name; shape (n,) each.

        Raises
        ------
        InputError
            If the actuators are not known.
        """
        known = read_actuators(section, axes, (rig or RigAxes.whole(axes)).places)
        for name in ("flow_gain", "oil_stiffness", "valve_frequency", "valve_damping"):
            if not known[name].all():
                raise InputError(
                    f"force_controller: actuator.{name} is not known, which velocity_feedforward "
                    "needs: find it with seft identify CONFIG, and give its model.yaml with "
                    "--params-file"
                )
        capacity = known["force_capacity"]
        known["force_capacity"] = np.where(capacity > 0.0, capacity, np.inf)
        return known

    def reset(self) -> None:
        """Begin a new test."""
        self.limited = False
        self._begin(self.parameters, self.state)

    def estimates(self) -> dict[str, Floats]:
        """Relative error of the flow gain and error of the delay (s) of each valve."""
        return {"flow_gain_error": self.state.errors[:, 0], "delay_error": self.state.errors[:, 1]}

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
