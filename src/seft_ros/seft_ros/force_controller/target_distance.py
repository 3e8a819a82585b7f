"""The detector `tracking`: the distance of the specimen to its target."""

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats, Ints, clear, zeros
from seft_msgs_py.config.facts import CHANNELS, FORCE_DRIVEN
from seft_plant_sim.channels import per_channel, velocity_is_derived
from seft_plant_sim.compiled import compiled
from seft_plant_sim.judge import detectors
from seft_plant_sim.judge.detector_list import TRACKING
from seft_plant_sim.judge.guard import DRIVE_ROW
from seft_plant_sim.judge.judge import BIAS
from seft_plant_sim.judge.judge_step import LONG_AGO
from seft_plant_sim.judge.known_rig import command_limit
from seft_plant_sim.judge.relation_following import NOISE_SIGMAS

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
    bias = BIAS * v * dt / (1.0 - detectors.fade_of_sums(dt))
    doubt = NOISE_SIGMAS * detectors.noise_of_sums(x, dt * v, dt) + bias
    memory, limited = math.exp(-dt / detectors.MOTION_MEMORY), math.ceil(_LIMITED / dt)
    persistence = detectors.persistence_of(TRACKING, dt)
    parameters = TrackingParameters(doubt, memory, limit, limited, persistence, acts)
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


def tracking_detector(
    section: Mapping[str, Any], axes: Sequence[str], places: Sequence[int], dt: float
) -> tuple[TrackingParameters, TrackingState]:
    """Make the detector of the distance to the target, for the axes at some places.

    The section is the force controller's, which is for all axes.
    """
    noise = per_channel(section, axes, "sensors.{}_noise")[:, list(places)]
    limits = np.array([section[f"limits.{name}"] for name in CHANNELS])
    noise = detectors.assumed_noise(noise, limits, velocity_is_derived(section), dt)
    has_valve = section["actuator.kind"] not in FORCE_DRIVEN
    limit = command_limit(section) if has_valve else math.inf
    acts = TRACKING.name not in detectors.warning_detectors(section)
    return tracking_arrays(noise, limit, acts, dt)
