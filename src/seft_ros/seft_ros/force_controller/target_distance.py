"""Whether the specimen follows its target: the detector ``tracking``, which knows the target."""

import math
from typing import NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats, Ints
from seft_plant_sim.compiled import compiled
from seft_plant_sim.judge.detector_list import TRACKING
from seft_plant_sim.judge.detectors import (
    MOTION_MEMORY,
    fade_of_sums,
    noise_of_sums,
    persistence_of,
)
from seft_plant_sim.judge.guard import DRIVE_ROW
from seft_plant_sim.judge.judge import BIAS
from seft_plant_sim.judge.judge_step import LONG_AGO
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
    """State of the detector.

    Attributes
    ----------
    largest : ndarray
        Largest recent motion, shape (n,), m.
    counts : ndarray
        Samples for which it has been beyond its threshold, shape (n,).
    shares : ndarray
        Largest part of its threshold that it has reached, shape (n,).
    found : ndarray
        Its value when it acted, and its threshold, shape (2, n), m.
    limited_at : ndarray
        Step of the last drive at the valve's limit, shape (1,).
    """

    largest: Floats
    counts: Ints
    shares: Floats
    found: Floats
    limited_at: Ints


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
    counts, limited_at = np.zeros(n, dtype=np.int64), np.zeros(1, dtype=np.int64)
    state = TrackingState(np.zeros(n), counts, np.zeros(n), np.zeros((2, n)), limited_at)
    return parameters, state


@compiled
def begin_tracking(state: TrackingState) -> None:
    """Begin a test."""
    state.largest[:] = 0.0
    state.counts[:] = 0
    state.shares[:] = 0.0
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
        share = away / threshold
        state.shares[i] = max(state.shares[i], share)
        state.counts[i] = state.counts[i] + 1 if share > 1.0 else max(state.counts[i] - 1, 0)
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
