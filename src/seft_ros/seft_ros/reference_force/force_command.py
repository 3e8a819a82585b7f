"""The reference force for an actuator that obeys forces with a delay.

The actuator's response T from reference force to acting force is inverted for the target's force,
which is known ahead. The remaining error is fed back at the time when a new force acts: the
specimen is predicted up to that time by its model, under the forces on their way, and drawn to the
target like a mass on a critically damped spring::

    f_r = sum_j h_j f*[k + j] + M_e (w^2 (x* - x) + 2 w (v* - v)) / T(0)                    (7)

The feedback is as fast as the delay allows: w is its inverse. Its gains are those of a force that
is held for a period, with the same poles e^(-w dt): w dt is 1 where a force acts a period later.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from seft_msgs_py.arrays import Complexes, Floats, zeros
from seft_msgs_py.errors import InputError
from seft_plant_sim.compiled import compiled, copy
from seft_plant_sim.lti import MIN_SAMPLES, noncausal_inverse

from seft_ros.reference_force.compensator import MethodInputs
from seft_ros.reference_force.restoring_model import THRESHOLDS
from seft_ros.reference_force.target_step import TargetParameters, TargetState, move_by_force


class CommandParameters(NamedTuple):
    """Parameters of a force command.

    Attributes
    ----------
    inverse : ndarray
        h, shape (taps,).
    static : float
        T(0).
    steps, part : int, float
        Delay of T in whole steps, and the part of a step beyond.
    pull : ndarray
        Of a mass to the target per displacement (1/s^2) and velocity (1/s), shape (2,).
    """

    inverse: Floats
    static: float
    steps: int
    part: float
    pull: Floats


class CommandState(NamedTuple):
    """State of a force command: arrays of zeros."""

    sent: Annotated[Floats, "sent", "n"]  # past commands, the newest first, N
    motion: Annotated[Floats, "motion"]  # displacements, then velocities of the predicted specimen
    stops: Annotated[Floats, "n", THRESHOLDS]  # its stop operators


def command_arrays(known: MethodInputs, horizon: int) -> tuple[CommandParameters, CommandState]:
    """Put a force command into arrays.

    Raises
    ------
    InputError
        If the horizon is too short for T.
    """
    parts = (known.options[f"actuator.response.{name}"] for name in ("numerator", "denominator"))
    numerator, denominator = (np.atleast_1d(np.asarray(part, dtype=np.float64)) for part in parts)
    dt, late = known.dt, float(np.max(known.options["actuator.response.dead_time"])) + known.late
    if not numerator.any():  # a pure delay, with the half step of the hold
        numerator = denominator = np.ones(1)
        late = known.delay - dt / 2
    static = numerator[-1] / denominator[-1]
    slopes = [part[-2] / part[-1] if len(part) > 1 else 0.0 for part in (numerator, denominator)]
    delay = late + slopes[1] - slopes[0]
    steps = max(int(delay / dt + 1e-6), 1)
    if steps + 2 > horizon:
        short = f"compensation.horizon is {horizon * dt:g} s; make it longer"
        raise InputError(f"reference_force: the rig's force is {delay:g} s late, but {short}")

    def response(s: Complexes) -> Complexes:
        hold = np.exp(-s * (late + dt / 2)) * np.sinc(s.imag * dt / math.tau)
        return hold * np.polyval(numerator, s) / np.polyval(denominator, s)

    taps, n = min(horizon, 3 * steps + 4), known.axes
    parameters = CommandParameters(
        inverse=noncausal_inverse(response, 1 / (MIN_SAMPLES * dt), taps, dt),
        static=static,
        steps=steps,
        part=delay / dt - steps,
        pull=_pull(dt / delay) / np.array([dt * dt, dt]),
    )
    return parameters, zeros(CommandState, {"n": n, "sent": steps + 1, "motion": 2 * n})


def _pull(rate: float) -> Floats:
    """Gains of held forces that give a free mass two poles e^-w; in periods, as ``rate`` w."""
    pole = math.exp(-rate)
    return np.array([(1.0 - pole) ** 2, (1.0 - pole) * (3.0 + pole) / 2.0])


@compiled
def command_step(
    parameters: CommandParameters,
    state: CommandState,
    target: TargetParameters,
    running: TargetState,
    points: Floats,
) -> None:
    """Replace the target's force of this step by Eq. (7).

    Parameters
    ----------
    parameters, state
        The state is updated.
    target, running
        Of the target at this step.
    points : ndarray
        See `target_step`, shape (taps or more, 3, n); the force of the first is replaced.
    """
    p, n = parameters, len(target.axes)
    y, stops = state.motion, state.stops
    copy(n, running.measured[0], y)
    copy(n, running.measured[1], y[n:])
    for i in range(n):
        copy(THRESHOLDS, running.model.stops[i], stops[i])
    # first the force of the present command acts for a part of a step, then those of the others
    for age in range(p.steps, -1, -1):
        span = p.part * target.dt if age == p.steps else target.dt
        move_by_force(target, running, state.sent[age], span, y, stops)
    for age in range(p.steps, 0, -1):
        copy(n, state.sent[age - 1], state.sent[age])
    # Eq. (7)
    here, there = p.steps, p.steps + 1
    for i in range(n):
        force = 0.0
        for j in range(len(p.inverse)):
            force += p.inverse[j] * points[j, 2, i]
        for k in range(n):
            x = points[here, 0, k] + p.part * (points[there, 0, k] - points[here, 0, k])
            v = points[here, 1, k] + p.part * (points[there, 1, k] - points[here, 1, k])
            pull = p.pull[0] * (x - y[k]) + p.pull[1] * (v - y[n + k])
            force += target.mass[i, k] * pull / p.static
        state.sent[0, i] = force
    copy(n, state.sent[0], points[0, 2])
