"""A displacement servo as identified, and the acceleration that it and the displacement tell.

Without an accelerometer, the acceleration is that of the response y to the applied commands, and
that of what the measured displacement shows beside it, e = x - y::

    a = y'' + e''

A steady Kalman filter with a random e''' estimates e, with the lag of `second_difference`.

So the acceleration has the servo's high frequencies as identified, the force as they are, and their
difference r = f - M a would mistake one for the other. A target therefore smooths force and
displacement alike, and takes the acceleration from the latter.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any, NamedTuple

import numpy as np
from scipy.linalg import solve_discrete_are
from seft_msgs_py.arrays import Floats, zeros
from seft_msgs_py.config.facts import POSITION_SERVO
from seft_msgs_py.errors import InputError

from seft_plant_sim.channels import acceleration_is_derived, least_noise, velocity_is_derived
from seft_plant_sim.compiled import compiled, copy, put_first
from seft_plant_sim.judge.known_rig import known_responses
from seft_plant_sim.judge.valve_model import NEGLIGIBLE_FLOW
from seft_plant_sim.lti import TransferFunction, first_order_hold
from seft_plant_sim.rig_parameters import common_lag

_DERIVATIVES = 3
"""States of e, and the integrations from its random third derivative."""
_TURNED = np.pi / 4.0
_REMEMBERED = 0.5
"""Longest memory of commands, s: a servo of 10 Hz has answered after a tenth of it."""
UNKNOWN_DELAY = 0.02
"""Delay of a servo that has not been identified, s."""


class ServoModel:
    """Response of a servo to a held command, without its dead time.

    Parameters
    ----------
    response : TransferFunction
        Of m poles, from command to displacement.
    dt : float
        Sampling period, s.
    states : int
        Number of states, at least m, the others without effect; default m.

    Attributes
    ----------
    free, push, output : ndarray
        z+ = F z + g u, y = c z; shapes (m, m), (m,) and (m,).
    rest : ndarray
        z and u for a displacement of 1 m at rest, shape (m + 1,).
    delay : float
        Up to the frequency at which it turns the phase by `_TURNED`, s. That of slow motions alone
        would be none with an integral gain.
    """

    def __init__(self, response: TransferFunction, dt: float, states: int = 0) -> None:
        m, leading = len(response.denominator) - 1, response.denominator[0]
        denominator, top = np.array(response.denominator) / leading, len(response.numerator)
        numerator = np.zeros(m)
        numerator[m - top :] = np.array(response.numerator) / leading
        self.delay = _delay(response, dt)
        # states in units of m, by the poles' mean frequency
        unit = abs(denominator[-1]) ** (1.0 / m)
        powers = unit ** np.arange(m, 0, -1.0)
        a, b = unit * np.eye(m, k=1), np.zeros((m, 1))
        a[-1] -= unit * denominator[:0:-1] / powers
        b[-1] = unit
        free, push, _ = first_order_hold(a, b, dt)
        unused = max(states - m, 0)
        self.free = np.pad(free, (0, unused))
        self.push = np.pad(push[:, 0], (0, unused))
        self.output = np.pad(numerator[::-1] / powers, (0, unused))
        at_rest = np.linalg.solve(np.eye(m + unused) - self.free, self.push)
        self.rest = np.append(at_rest, 1.0) / (self.output @ at_rest)


def _delay(response: TransferFunction, dt: float) -> float:
    """See `ServoModel.delay`."""
    f = np.geomspace(1e-4, 0.5, 2000) / dt
    without = replace(response, dead_time=0.0).response(f)
    turned = -np.unwrap(np.angle(without / without[0])) >= _TURNED
    first = max(1, int(np.argmax(np.append(turned, True))) - 1)
    return float(_TURNED / (2.0 * np.pi * f[first]))


def servo_models(responses: Sequence[TransferFunction], dt: float) -> list[ServoModel]:
    """Make the models of n servos, with the states of that which has most."""
    states = max(len(response.denominator) for response in responses) - 1
    return [ServoModel(response, dt, states) for response in responses]


def last_periods(section: Mapping[str, Any], responses: Sequence[TransferFunction]) -> Floats:
    """Mean velocity in the last period of past commands, and its change per delay; (n, 2, memory).

    Of servos, as `ValveModel.last_period` gives the flow of valves.
    """
    dt, lag = 1.0 / section["rate"], common_lag(section)
    models = servo_models(responses, dt)
    moved = np.zeros((len(models), round(_REMEMBERED / dt)))  # by a command of one period
    for row, model in zip(moved, models, strict=True):
        z = model.push
        for k in range(1, len(row)):
            row[k] = model.output @ z
            z = model.free @ z
    largest = np.abs(moved).max(axis=1, keepdims=True)
    memory = int(np.flatnonzero((np.abs(moved) > NEGLIGIBLE_FLOW * largest).any(axis=0))[-1]) + 1
    late = [(response.dead_time + lag) / dt + 1.0 for response in responses]
    age = np.arange(memory + int(max(late)) + 2)
    each = zip(late, moved, strict=True)
    shown = [np.interp(age - after, age[:memory], row[:memory], 0.0, 0.0) for after, row in each]
    rate = np.gradient(shown, axis=1) / dt
    return np.ascontiguousarray(np.diff([shown, -rate], axis=2).swapaxes(0, 1) / dt)


class AccelerationParameters(NamedTuple):
    """How the accelerations of n servos of m states are derived; n is 0 if they are measured.

    Attributes
    ----------
    dt : float
        Sampling period, s.
    late : ndarray
        From a command to its first effect as measured, in periods, shape (n,).
    free, push, output : ndarray
        See `ServoModel`, shapes (n, m, m), (n, m) and (n, m).
    gains : ndarray
        Of the filter of e, shape (n, 3).
    derives_velocity : bool
        Whether it is not measured either.
    """

    dt: float
    late: Floats
    free: Floats
    push: Floats
    output: Floats
    gains: Floats
    derives_velocity: bool


class AccelerationState(NamedTuple):
    """State of that: arrays of zeros."""

    model: Annotated[Floats, "n", "m"]  # z of each servo
    next: Annotated[Floats, "n", "m"]  # room
    past: Annotated[Floats, "n", "memory"]  # y of the next sample without dead time, then before
    beside: Annotated[Floats, "n", "derivatives"]  # e, e' and e''
    response: Annotated[Floats, "n"]  # y at the sample


def smoothing_steps(section: Mapping[str, Any], axes: Sequence[str]) -> int:
    """Count the steps M of the second difference that gives an acceleration.

    Its window is as long as the delay of the slowest servo, by the samples that it averages, 3/2 M:
    what happens within that can't be answered anyway.
    """
    dt, delay = 1.0 / section["rate"], UNKNOWN_DELAY
    if np.any(section["actuator.response.numerator"]):
        servos = known_responses(section, tuple(axes), range(len(axes)))
        delay = max(each.dead_time + ServoModel(each, dt).delay for each in servos) + 1.5 * dt
    return max(2, round(delay / (1.5 * dt)))


def second_difference(steps: int, dt: float) -> Floats:
    """Weights of past samples, the newest first, that smooth a signal alike in three ways.

    They give it, and its first and second derivative, ``steps`` samples ago, by a triangular
    window; shape (3, 2 steps + 1). What is smoothed alike still obeys f = M a + r.
    """
    place = np.arange(-1, 2 * steps + 2)
    window = np.maximum(steps - np.abs(place - steps), 0.0) / steps**2
    newer, now, older = window[2:], window[1:-1], window[:-2]
    return np.array([now, (newer - older) / (2.0 * dt), (newer - 2.0 * now + older) / dt**2])


def derived_noise(section: Mapping[str, Any], axes: Sequence[str]) -> Floats:
    """RMS noise of displacement, velocity and acceleration by `second_difference`, shape (3, n)."""
    weights = second_difference(smoothing_steps(section, axes), 1.0 / section["rate"])
    return np.outer(np.linalg.norm(weights, axis=1), least_noise(section, axes)[0])


def acceleration_of(
    section: Mapping[str, Any], axes: tuple[str, ...], places: Sequence[int], dt: float
) -> tuple[AccelerationParameters, AccelerationState]:
    """Put the derivation of some axes into arrays, from the rig's section.

    Raises
    ------
    InputError
        If it is derived, and the response that is given is none of a servo.
    """
    kind = section["actuator.kind"]
    if acceleration_is_derived(section) and kind != POSITION_SERVO:
        why = f"only the commands of a {POSITION_SERVO} tell the acceleration; measure it"
        other = f"actuator.kind is {kind}: {why}"
        raise InputError(f"/**: sensors.acceleration is derived, but {other}")
    if not acceleration_is_derived(section):
        none = np.zeros((0, 0))
        late = np.zeros(0)
        parameters = AccelerationParameters(dt, late, np.zeros((0, 0, 0)), none, none, none, False)
        return parameters, AccelerationState(none, none, none, none, late)
    own, lag, n = list(places), common_lag(section), len(places)
    is_known = np.any(section["actuator.response.numerator"])
    responses = [TransferFunction((1.0,), (1.0, 1.0))] * n
    if is_known:
        responses = known_responses(section, axes, own)
    models = servo_models(responses, dt)
    late = np.array([(response.dead_time + lag) / dt for response in responses])
    rate = 2.0 / (smoothing_steps(section, axes) * dt)
    parameters = AccelerationParameters(
        dt=dt,
        late=late,
        free=np.array([model.free for model in models]),
        push=np.array([model.push for model in models]),
        output=is_known * np.array([model.output for model in models]),
        gains=np.tile(_gains(rate, dt), (n, 1)),
        derives_velocity=velocity_is_derived(section),
    )
    m = parameters.push.shape[1]
    sizes = {"n": n, "m": m, "memory": int(late.max()) + 4, "derivatives": _DERIVATIVES}
    return parameters, zeros(AccelerationState, sizes)


def _gains(rate: float, dt: float) -> Floats:
    """Gains of the filter of e, shape (3,), whose poles are at a rate in rad/s."""
    step = rate * dt  # in units of noise, and periods
    free = np.array([[1.0, 1.0, 0.5], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
    push = np.array([1.0 / 6.0, 0.5, 1.0])
    seen = np.array([[1.0], [0.0], [0.0]])
    found = solve_discrete_are(free.T, seen, np.outer(push, push) * step**6, np.eye(1))
    gain: Floats = found[:, 0] / (found[0, 0] + 1.0)
    return gain / dt ** np.arange(3.0)


@compiled
def derive_acceleration(
    p: AccelerationParameters, state: AccelerationState, step: int, drive: Floats, measured: Floats
) -> None:
    """Derive acceleration and velocity of a sample, shape (4, n), if they are not measured.

    The displacements so far tell them, see `follow_displacement`. The drive is applied from this
    sample on, shape (n,), m.
    """
    for i in range(len(p.late)):
        z, new, past, e = state.model[i], state.next[i], state.past[i], state.beside[i]
        m = len(z)
        y = 0.0
        for row in range(m):
            new[row] = p.push[i, row] * drive[i]
            for j in range(m):
                new[row] += p.free[i, row, j] * z[j]
            y += p.output[i, row] * new[row]
        copy(m, new, z)
        put_first(past, y)
        whole = int(p.late[i])
        part, k = p.late[i] - whole, whole + 1
        y = past[k] + part * (past[k + 1] - past[k])
        rate, before = past[k - 1] - past[k + 1], past[k] - past[min(k + 2, len(past) - 1)]
        bend = past[k - 1] - 2.0 * past[k] + past[k + 1]
        then = past[k] - 2.0 * past[k + 1] + past[min(k + 2, len(past) - 1)]
        bend = (bend + part * (then - bend)) / (p.dt * p.dt)
        if step > 0:
            e[0] += p.dt * (e[1] + 0.5 * p.dt * e[2])
            e[1] += p.dt * e[2]
        state.response[i] = y
        measured[2, i] = bend + e[2]
        if p.derives_velocity:
            measured[1, i] = (rate + part * (before - rate)) / (2.0 * p.dt) + e[1]


@compiled
def follow_displacement(
    p: AccelerationParameters, state: AccelerationState, step: int, judged: Floats
) -> None:
    """Update e by the displacements of a sample, shape (4, n), once they are judged."""
    for i in range(len(p.late)):
        e = state.beside[i]
        off = judged[0, i] - state.response[i] - e[0]
        if step == 0:
            e[0] += off
            continue
        for j in range(len(e)):
            e[j] += p.gains[i, j] * off
