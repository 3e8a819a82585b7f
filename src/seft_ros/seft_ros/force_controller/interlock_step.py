"""Steps of the interlock: what a force and a command may be; the detector ``tracking``.

The detector sees whether the specimen follows its target, which only the interlock knows.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats, Ints, clear, zeros
from seft_plant_sim.compiled import compiled, copy
from seft_plant_sim.judge.detector_list import TRACKING
from seft_plant_sim.judge.detectors import (
    MOTION_MEMORY,
    fade_of_sums,
    noise_of_sums,
    persistence_of,
)
from seft_plant_sim.judge.guard import DRIVE_ROW, SUSPECT_ROW
from seft_plant_sim.judge.judge import BIAS
from seft_plant_sim.judge.judge_step import LONG_AGO
from seft_plant_sim.judge.relation_following import NOISE_SIGMAS
from seft_plant_sim.limits import is_exceeded
from seft_plant_sim.simulated.rig_step import left_open

from seft_ros.protection.protection_step import as_sample, extrapolate

_FARTHEST = 0.5
"""Largest distance to the target over the target's motion."""
_LIMITED = 0.1
"""Time after a command at the valve's limit in which the distance may be larger, s."""


class TrackingParameters(NamedTuple):
    """Parameters of the detector for n axes.

    Attributes
    ----------
    doubt : ndarray
        Distance by noise and biases of displacement and velocity, shape (n,), m.
    memory : float
        Factor per step with which the largest motion fades.
    limit : float
        Largest drive of a valve, V; infinite without valves.
    limited : int
        Samples after one at the valve's limit in which the target need not be followed.
    persistence : int
        Samples for which it must be beyond its threshold.
    acts : bool
        Whether it ends the test, or only warns.
    """

    doubt: Floats
    memory: float
    limit: float
    limited: int
    persistence: int
    acts: bool


class TrackingState(NamedTuple):
    """State of the detector: arrays of zeros, but for ``limited_at``."""

    largest: Annotated[Floats, "n"]  # recent motion, m
    counts: Annotated[Ints, "n"]  # samples for which it has been beyond its threshold
    shares: Annotated[Floats, "n"]  # largest part of its threshold that it has reached
    found: Annotated[Floats, 2, "n"]  # its value when it acted, and its threshold, m
    limited_at: Annotated[Ints, 1]  # step of the last drive at the valve's limit


def tracking_arrays(
    noise: Floats, limit: float, acts: bool, dt: float
) -> tuple[TrackingParameters, TrackingState]:
    """Put the detector into arrays.

    Parameters
    ----------
    noise : ndarray
        RMS noise of displacement, velocity, acceleration and force, shape (4, n), see
        `assumed_noise`.
    limit, acts
        See `TrackingParameters`.
    dt : float
        Sampling period, s.
    """
    (x, v, _, _), n = noise, noise.shape[1]
    bias = BIAS * v * dt / (1.0 - fade_of_sums(dt))
    parameters = TrackingParameters(
        NOISE_SIGMAS * noise_of_sums(x, dt * v, dt) + bias,
        math.exp(-dt / MOTION_MEMORY),
        limit,
        math.ceil(_LIMITED / dt),
        persistence_of(TRACKING, dt),
        acts,
    )
    return parameters, zeros(TrackingState, {"n": n})


def begin_tracking(state: TrackingState) -> None:
    """Begin a test."""
    clear(state)
    state.limited_at[0] = LONG_AGO


@compiled
def off_target(
    p: TrackingParameters, state: TrackingState, step: int, target: Floats, measured: Floats
) -> int:
    """Say which axis is away from its target, although the valve is not at its limit; -1: none.

    Parameters
    ----------
    p, state
        The state is updated.
    step : int
        Of the sample.
    target : ndarray
        Displacement of the target, shape (n,), m.
    measured : ndarray
        The rig's sample with its drive, see `guard_step`, shape (6, n).
    """
    found = -1
    for i in range(len(target)):
        if abs(measured[DRIVE_ROW, i]) >= p.limit:
            state.limited_at[0] = step
    for i in range(len(target)):
        away = abs(target[i] - measured[0, i])
        largest = max(abs(target[i]), abs(measured[0, i]), p.memory * state.largest[i])
        state.largest[i] = largest
        threshold = p.doubt[i] + _FARTHEST * largest
        if step - state.limited_at[0] <= p.limited:
            threshold = np.inf  # the interlock counts these
        if away > state.shares[i] * threshold:  # a division takes longer
            state.shares[i] = away / threshold
        state.counts[i] = state.counts[i] + 1 if away > threshold else max(state.counts[i] - 1, 0)
        if state.counts[i] >= p.persistence and p.acts and found < 0:
            state.found[0, i], state.found[1, i] = away, threshold
            found = i
    return found


@compiled
def track_all(
    p: TrackingParameters, state: TrackingState, steps: Ints, targets: Floats, samples: Floats
) -> None:
    """Look at the samples of a whole test.

    Parameters
    ----------
    p, state
        The state, after its begin; it is updated.
    steps, targets, samples : ndarray
        Steps of the N samples, (N,), displacements of the target, (N, n), and samples (N, 6, n).
    """
    for k in range(len(steps)):
        off_target(p, state, steps[k], targets[k], samples[k])


TRIP, STEP, SATURATED, AXIS = range(4)
"""Places of the flags: reason and step of the trip, number of limited drives, and the axis that is
away from its target."""
NO_TRIP, IMPLAUSIBLE, IMPLAUSIBLE_COMMAND, SATURATION, OFF_TARGET, LIMIT, OUTSIDE = range(7)
"""Reasons of a trip; the last one is a reason from outside."""
VALID_CAUSES = NO_TRIP, IMPLAUSIBLE, LIMIT
"""With these, valves and controller are fault-free, so that a stop can follow the plan."""


class InterlockParameters(NamedTuple):
    """Parameters of an interlock.

    Attributes
    ----------
    largest : float
        Magnitude of the reference force beyond which it is implausible, N.
    window : int
        Steps of a second.
    closing : float
        Steps in which the valve closes after a trip; infinite: the last command is held.
    has_stop : bool
        Whether the controller can stop along its plan.
    limits : ndarray
        Largest displacement, velocity, acceleration and force of a sample, shape (4,).
    has_valve : bool
        Whether its commands drive the rig.
    dt : float
        Sampling period, s.
    fastest : float
        Largest change of a command in a step.
    tracking : TrackingParameters
        Of the distance to the target.
    """

    largest: float
    window: int
    closing: float
    has_stop: bool
    limits: Floats
    has_valve: bool
    dt: float
    fastest: float
    tracking: TrackingParameters


class InterlockState(NamedTuple):
    """State of an interlock: arrays of zeros, but for ``tracking``."""

    flags: Annotated[Ints, 4]  # see `TRIP`
    saturated: Ints  # the last steps at which the drive was limited, see `is_exceeded`
    force: Annotated[Floats, "n"]  # reference force of the step of the trip, N
    measured: Annotated[Floats, 4, "n"]  # its sample
    odd: Annotated[Floats, "n"]  # its drive
    drive: Annotated[Floats, "n"]  # the last fault-free command, V
    plan: Annotated[Floats, "points", "quantities", "n"]  # points for the controller
    sample: Annotated[Floats, 4, "n"]  # for the controller
    tracking: TrackingState  # of the distance to the target


@compiled
def check_limits(
    parameters: InterlockParameters, state: InterlockState, step: int, measured: Floats
) -> None:
    """Trip if a judged sample is beyond a limit: then the stop follows the plan."""
    if state.flags[TRIP] == NO_TRIP:
        for row in range(4):
            for i in range(measured.shape[1]):
                if abs(measured[row, i]) > parameters.limits[row]:
                    trip(state, LIMIT, step)
            copy(measured.shape[1], measured[row], state.measured[row])


@compiled
def precheck(
    parameters: InterlockParameters,
    state: InterlockState,
    step: int,
    points: Floats,
    measured: Floats,
    command: Floats,
) -> bool:
    """Say whether the controller answers a step; otherwise give its command.

    The controller answers `InterlockState.plan` and `InterlockState.sample`. While a sample is
    suspect, these are the motion that the last fault-free target has predicted for this step;
    without a target, the last fault-free command is held. At a trip the stop begins, see
    `Interlock.stop`.

    Parameters
    ----------
    parameters, state
        The state is updated.
    step : int
        The step.
    points : ndarray
        Of the reference force, shape (p, q, n).
    measured : ndarray
        The step's sample of rig/state, shape (6, n).
    command : ndarray
        Shape (n,), V.
    """
    last, n = points.shape[1] - 1, points.shape[2]
    if state.flags[TRIP] == NO_TRIP:
        fits, has_target, away = True, state.plan.shape[1] > 1 and last > 0, -1
        for i in range(n):
            fits &= abs(points[0, last, i]) <= parameters.largest
        if fits and has_target:  # a controller of forces reads them alone
            target = points[0, 0]
            away = off_target(parameters.tracking, state.tracking, step, target, measured)
        if not fits or away >= 0:
            trip(state, OFF_TARGET if fits else IMPLAUSIBLE, step)
            state.flags[AXIS] = away
            copy(n, points[0, last], state.force)
        elif measured[SUSPECT_ROW, 0] == 0.0:
            take_plan(state, points, measured)
            return True
        elif has_target:
            follow_plan(state, parameters.dt)
            return True
    begin_stop(parameters, state, command)
    return False


@compiled
def take_plan(state: InterlockState, points: Floats, measured: Floats) -> None:
    """Let the controller answer a sample; store of its points what it follows.

    The force is the last row. It is alone while the nodes warm up; a controller of forces follows
    it alone also where there is a target.
    """
    count, quantities, n = state.plan.shape
    first = points.shape[1] - quantities
    for point in range(count):
        sent = points[min(point, len(points) - 1)]
        for row in range(quantities):
            copy(n, sent[max(0, first + row)], state.plan[point, row])
    for row in range(4):
        copy(n, measured[row], state.sample[row])


@compiled
def follow_plan(state: InterlockState, dt: float) -> None:
    """Let the controller answer the motion that was predicted before samples were suspect."""
    extrapolate(state.plan, 1, dt, state.plan)
    as_sample(state.plan, dt, state.sample)


@compiled
def postcheck(
    parameters: InterlockParameters,
    state: InterlockState,
    step: int,
    limited: bool,
    command: Floats,
) -> None:
    """Check the command of a controller, and whether it is limited; trip if it is not finite.

    So it does if the command of a displacement servo jumps.
    """
    for i in range(len(command)):
        change = abs(command[i] - state.drive[i]) if step > 0 else 0.0
        if not np.isfinite(command[i]) or change > parameters.fastest:
            trip(state, IMPLAUSIBLE_COMMAND, step)
    if limited and parameters.has_valve and state.flags[TRIP] == NO_TRIP:
        if is_exceeded(state.saturated, state.flags[SATURATED], step, parameters.window):
            trip(state, SATURATION, step)
        state.flags[SATURATED] += 1
    if state.flags[TRIP] == NO_TRIP:
        copy(len(command), command, state.drive)
    else:
        copy(len(command), command, state.odd)
        begin_stop(parameters, state, command)


@compiled
def begin_stop(parameters: InterlockParameters, state: InterlockState, command: Floats) -> None:
    """Give the command of the step of a trip; without a trip, hold the last one."""
    why, left = state.flags[TRIP], 1.0
    if why != NO_TRIP and not (parameters.has_stop and why in VALID_CAUSES):
        left = left_open(1, parameters.closing)
    for i in range(len(command)):
        command[i] = left * state.drive[i]


@compiled
def trip(state: InterlockState, why: int, step: int) -> None:
    """Stop from now on."""
    state.flags[TRIP] = why
    state.flags[STEP] = step
