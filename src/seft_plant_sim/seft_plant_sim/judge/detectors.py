"""Detectors of faulty sensors, valves and supplies: their thresholds and their arrays."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats, Ints

from seft_plant_sim.compiled import compiled
from seft_plant_sim.judge.detector_list import DETECTORS, Detector
from seft_plant_sim.judge.judge import JudgeParameters, JudgeState, judge_arrays
from seft_plant_sim.judge.relation_following import ESTIMATE_DRIFT, NOISE_SIGMAS
from seft_plant_sim.judge.valve_following import (
    LARGEST_DELAY_ERROR,
    LARGEST_GAIN_ERROR,
    UNCERTAIN_DELAY,
    UNCERTAIN_GAIN,
)

_MEMORY, _OIL_MEMORY = 0.05, 0.2
"""Time constants of the sums of both sides of relations (1) and (2), and of (3), s: to longer sums
the displacement adds no noise, as velocity and acceleration do."""
SHORT, FEWEST = 0.015, 7.0
"""Time constant of short sums (of the second-order work, of noise), s, and its least value in
samples: with fewer, some friction looks like noise."""
BIAS = 2.0
"""Largest constant error of a sensor that is no fault, over its RMS noise."""
MOTION_MEMORY = 0.3
"""Time constant of the memory of the largest motion, and of the mean that gives a bias, s: a
quarter of a cycle at 1 Hz."""
TOLERANCES = (0.1, 0.1, 0.35)
"""Largest difference of relations (1) to (3) over the motion: calibration and channels 2 ms apart
at 7 Hz; a flow gain with an error of 0.3, which the controller corrects."""
UNDESCRIBED = (0.02, 0.02, 0.1)
"""Part of these that gain, delay and bias do not describe, at the beginning: a sensor's linearity,
a valve's, and the piston's friction."""
CHANNELS_APART = 2e-3
"""Largest time by which two channels are apart, s."""
NULL = 0.03
"""Standard deviation of a valve's null, over its full flow (servo-valves of a test's accuracy)."""
ASSUMED_NOISE = 1e-3
"""RMS noise of a sensor whose noise is not configured, over the limit of its channel."""


class DetectorParameters(NamedTuple):
    """Parameters of the detectors of n axes.

    Attributes
    ----------
    dt : float
        Sampling period, s.
    fade, short, memory : float
        Factors per step with which sums, short sums and the largest motion fade.
    oil_fade : float
        That of the sums of relation (3).
    actuator : ndarray
        Flow gain, oil stiffness, leakage and force capacity, see `FeedforwardParameters`; (n, 4).
    past : ndarray
        Part of past commands in the mean flow of the last period, the newest first, and its change
        per delay (1/s); shape (n, 2, m).
    has_valve : bool
        Whether valves drive the rig; else it obeys the reference force, which it holds.
    mass, stiffness : ndarray
        Of the assumed specimen, shape (n, n), kg and N/m.
    by_force : ndarray
        Jump of the acceleration by that of a held force, shape (n, n), 1/kg; 0 with a valve, or if
        the mass is not known.
    computed_mass : ndarray
        M_c on the axes, shape (n, n), kg.
    noise, dither : ndarray
        RMS noise of the sensors, shape (4, n): assumed, and configured (0: not configured).
    range : ndarray
        Largest value that each sensor can measure, shape (4, n); infinite if it is not known.
    sums : ndarray
        Noise of the sums of the differences of relations (1) to (3), shape (3, n):
        `NOISE_SIGMAS` times RMS; infinite where not watched.
    deviation, most, drift : ndarray
        Of the estimated gain, delay (s) and bias of each relation: standard deviation at the
        beginning, largest value, growth of the variance in a step; shape (3, 3, n).
    correlated : ndarray
        So many samples of each relation count as one, shape (3,).
    late : float
        Time by which a derived velocity is late, s; 0: it is measured.
    rough : ndarray
        Noise of the second difference of r, likewise, shape (n,), N.
    unknown : float
        0; infinite if the specimen is not known.
    tolerance : ndarray
        Part of the largest motion by which the sides of a relation may differ, shape (3,).
    left : ndarray
        Likewise, less what gain, delay and bias describe, at the beginning; shape (3,).
    persistence : ndarray
        Samples for which a detector must be beyond its threshold, shape (D,).
    acts : ndarray
        Whether a detector ends the test, shape (D,); 0: it only warns.
    judge : JudgeParameters
        Of the judge.
    """

    dt: float
    fade: float
    oil_fade: float
    short: float
    memory: float
    actuator: Floats
    past: Floats
    has_valve: bool
    mass: Floats
    stiffness: Floats
    by_force: Floats
    computed_mass: Floats
    noise: Floats
    dither: Floats
    range: Floats
    sums: Floats
    deviation: Floats
    most: Floats
    drift: Floats
    correlated: Floats
    late: float
    rough: Floats
    unknown: float
    tolerance: Floats
    left: Floats
    persistence: Ints
    acts: Ints
    judge: JudgeParameters


class DetectorState(NamedTuple):
    """State of the detectors.

    Attributes
    ----------
    last : ndarray
        The last sample, shape (4, n).
    flow : ndarray
        Mean flow of the valve without load since the last sample, m/s, and its change per delay,
        m/s^2; shape (2, n).
    estimated, covariance : ndarray
        Estimated gain, delay and bias of relations (1) to (3), see `relation_following`; shapes
        (3, 3, n) and (3, n, 3, 3).
    scatter : ndarray
        See `remember`, shape (3, 2, n).
    sent : ndarray
        Past commands, the newest first, shape (n, m), V.
    sums : ndarray
        Of relations (1) to (3), see `relation_following`; shape (3, 4, n).
    rise : ndarray
        Last change of the acceleration, largest recent change of that, and the sum of the jumps by
        a held force, m/s^2, shape (3, n).
    largest : ndarray
        Largest recent values: of these sums, and of r; shape (4, n).
    restoring : ndarray
        r at the last sample, its last change, and the present r; shape (3, n), N.
    work : ndarray
        Sums of dr dx, of dx K dx and of squares of its noise, shape (3,).
    farthest, carried : ndarray
        In both directions, the farthest displacement, shape (2, n), x K x there in N m, and the
        force in sqrt(N m), shape (2, 2), see `look_at_strength`.
    response : ndarray
        Sums of squares of the changes of f and of M_c a, shape (2, n), N^2.
    bends : ndarray
        Second difference of r while it is beyond its threshold, N, and the recent frequency of its
        changes of sign; shape (2, n).
    repeats : ndarray
        Number of repetitions of the last value of a channel, shape (4, n).
    mean : ndarray
        That flow under the last load, as the estimates expect it, shape (n,), m/s.
    counts : ndarray
        Samples for which each detector has been beyond its threshold, shape (D, n).
    shares : ndarray
        Largest part of its threshold that each has reached, shape (D, n).
    found : ndarray
        Value of each detector when it last acted, and its threshold; shape (2, D, n).
    step : ndarray
        Steps of the last sample, the last turn of the motion and the last sample at the end of
        each channel's range, shape (6,); a large negative number at the beginning.
    judge : JudgeState
        Of the judge.
    """

    last: Floats
    flow: Floats
    estimated: Floats
    covariance: Floats
    scatter: Floats
    sent: Floats
    sums: Floats
    rise: Floats
    largest: Floats
    restoring: Floats
    work: Floats
    farthest: Floats
    carried: Floats
    response: Floats
    bends: Floats
    repeats: Ints
    mean: Floats
    counts: Ints
    shares: Floats
    found: Floats
    step: Ints
    judge: JudgeState


def assumed_noise(noise: Floats, limits: Floats, velocity_is_derived: bool, dt: float) -> Floats:
    """Give the RMS noise of the channels, shape (4, n), also where it is not known (0)."""
    x, v, a, f = np.where(noise > 0.0, noise, ASSUMED_NOISE * limits[:, np.newaxis])
    return np.array([x, math.sqrt(2.0) * x / dt if velocity_is_derived else v, a, f])


def fade_of_sums(dt: float) -> float:
    """Factor per step with which the sums of relations (1) and (2) fade."""
    return math.exp(-dt / _MEMORY)


def noise_of_sums(jump: Floats, rate: Floats, dt: float) -> Floats:
    """RMS noise of the sum of a side's changes, of noise ``jump``, less the other's, ``rate``."""
    fade = fade_of_sums(dt)
    return np.asarray(np.sqrt(jump**2 * 2.0 / (1.0 + fade) + rate**2 / (2.0 * (1.0 - fade))))


def persistence_of(detector: Detector, dt: float) -> int:
    """Count the samples for which a detector must be beyond its threshold."""
    return max(3 if detector.lasts else 2, math.ceil(detector.lasts / dt - 1e-9))


def detector_arrays(
    noise: Floats,
    limits: Floats,
    ranges: Floats,
    velocity_is_derived: bool,
    actuator: Floats,
    past: Floats,
    has_valve: bool,
    mass: Floats,
    stiffness: Floats,
    computed_mass: Floats,
    warn_only: Sequence[str],
    largest_drive: float,
    dt: float,
) -> tuple[DetectorParameters, DetectorState]:
    """Put the detectors of n axes into arrays.

    Parameters
    ----------
    noise : ndarray
        RMS noise of displacement, velocity, acceleration and force, shape (4, n); 0: not known.
    limits : ndarray
        Their largest values, shape (4,).
    ranges : ndarray
        Largest value that each sensor can measure, shape (4, n); 0: not known.
    velocity_is_derived : bool
        Whether the velocity is derived from the displacement.
    actuator, past : ndarray
        See `DetectorParameters`; a flow gain or an oil stiffness of 0 is not known. A displacement
        servo has a gain of 1, and an infinite stiffness.
    has_valve : bool
        Whether these valves drive the rig.
    mass, stiffness, computed_mass : ndarray
        Shape (n, n), kg, N/m and kg.
    warn_only : sequence of str
        Names of the detectors that do not end a test.
    largest_drive : float
        Of a valve, V.
    dt : float
        Sampling period, s.
    """
    n, fade, oil_fade = noise.shape[1], fade_of_sums(dt), math.exp(-dt / _OIL_MEMORY)
    short = math.exp(-1.0 / max(SHORT / dt, FEWEST))
    x, v, a, f = assumed_noise(noise, limits, velocity_is_derived, dt)
    known = has_valve & (actuator[:, 0] > 0.0) & (actuator[:, 1] > 0.0)
    actuator = actuator.copy()
    actuator[~known, 1] = 1.0
    actuator[actuator[:, 3] <= 0.0, 3] = np.inf
    oil, one = np.where(known, f / actuator[:, 1], np.inf), np.ones(n)
    sums = np.array([noise_of_sums(x, dt * v, dt), noise_of_sums(v, dt * a, dt)])
    of_oil = np.hypot(x, oil) * math.sqrt(2.0 / (1.0 + oil_fade))
    late = UNCERTAIN_DELAY if velocity_is_derived else 0.0
    null = np.where(known, NULL * actuator[:, 0] * largest_drive, 0.0)
    most = np.array(
        [
            [TOLERANCES[0] * one, (CHANNELS_APART + late) * one, BIAS * v],
            [TOLERANCES[1] * one, (CHANNELS_APART + late) * one, BIAS * a],
            [LARGEST_GAIN_ERROR * one, LARGEST_DELAY_ERROR * one, NOISE_SIGMAS * null],
        ]
    )
    deviation = most.copy()
    deviation[:2, :2] /= NOISE_SIGMAS
    deviation[2] = UNCERTAIN_GAIN * one, UNCERTAIN_DELAY * one, null
    unknown = 0.0 if mass.any() and stiffness.any() else math.inf
    by_force = np.zeros_like(mass) if has_valve or not mass.any() else np.linalg.inv(mass)
    lasts = np.array([persistence_of(each, dt) for each in DETECTORS])
    judging, judged = judge_arrays(
        np.array([x, v, a, f]),
        np.transpose(
            [np.where(known & (actuator[:, 1] < np.inf), actuator[:, 1], 0.0), actuator[:, 2]]
        ),
        mass,
        stiffness,
        np.where(ranges > 0.0, ranges, np.inf),
        late,
        NOISE_SIGMAS,
        dt,
    )
    lasts[WRONG:] = 1  # they count by themselves
    acts = [each.name not in warn_only for each in DETECTORS]
    parameters = DetectorParameters(
        dt=dt,
        fade=fade,
        oil_fade=oil_fade,
        short=short,
        memory=math.exp(-dt / MOTION_MEMORY),
        actuator=actuator,
        past=past,
        has_valve=has_valve,
        mass=mass,
        stiffness=stiffness,
        by_force=by_force,
        computed_mass=computed_mass,
        noise=np.array([x, v, a, f]),
        dither=noise,
        range=judging.range,
        sums=NOISE_SIGMAS * np.vstack([sums, of_oil]),
        deviation=deviation,
        most=most,
        drift=(ESTIMATE_DRIFT * deviation) ** 2 * dt,
        correlated=np.maximum(1.0, np.array([_MEMORY, _MEMORY, _OIL_MEMORY]) / dt),
        late=judging.late,
        rough=judging.noise[3] + unknown,
        unknown=unknown,
        tolerance=np.array(TOLERANCES),
        left=np.array(UNDESCRIBED),
        persistence=lasts,
        acts=np.array(acts, dtype=np.int64),
        judge=judging,
    )
    state = DetectorState(
        last=np.zeros((4, n)),
        flow=np.zeros((2, n)),
        estimated=np.zeros((3, 3, n)),
        covariance=np.zeros((3, n, 3, 3)),
        scatter=np.zeros((3, 2, n)),
        sent=np.zeros_like(past[:, 0]),
        sums=np.zeros((3, 4, n)),
        rise=np.zeros((3, n)),
        largest=np.zeros((4, n)),
        restoring=np.zeros((3, n)),
        work=np.zeros(3),
        farthest=np.zeros((2, n)),
        carried=np.zeros((2, 2)),
        response=np.zeros((2, n)),
        bends=np.zeros((2, n)),
        repeats=np.zeros((4, n), dtype=np.int64),
        mean=np.zeros(n),
        counts=np.zeros((len(DETECTORS), n), dtype=np.int64),
        shares=np.zeros((len(DETECTORS), n)),
        found=np.zeros((2, len(DETECTORS), n)),
        step=np.zeros(6, dtype=np.int64),
        judge=judged,
    )
    return parameters, state


SAMPLE, TURN_AT, AT_RANGE = range(3)
"""Places of `DetectorState.step`."""
DISPLACEMENT_VELOCITY, VELOCITY_ACCELERATION, OIL = range(3)
"""Relations (1) to (3)."""
DIFFERS, SECOND_ORDER_WORK, WEAKENS, ROUGH, JUMP = 0, *range(3, 7)
NO_RESPONSE, FROZEN, WRONG = 7, 8, 12
"""Rows of the detectors: sums of three relations, ..., four frozen and four wrong channels."""


@compiled
def look(
    p: DetectorParameters,
    state: DetectorState,
    row: int,
    i: int,
    seen: float,
    threshold: float,
) -> bool:
    """Compare a detector's value with its threshold; say whether it has persisted and acts."""
    share = seen / threshold if threshold > 0.0 else 0.0
    if share > state.shares[row, i]:
        state.shares[row, i] = share
    count = state.counts[row, i]
    state.counts[row, i] = count = count + 1 if share > 1.0 else max(count - 1, 0)
    if count >= p.persistence[row] and p.acts[row]:
        state.found[0, row, i], state.found[1, row, i] = seen, threshold
        return True
    return False


@compiled
def sees(state: DetectorState, step: int, row: int) -> bool:
    """Say whether a channel was within its range at this sample and the last one."""
    return step - state.step[AT_RANGE + row] > 1


VALID, SUSPECT = -1, -2
"""Results if no detector ends the test: nothing is beyond its threshold, or the controller must not
use the sample."""


@compiled
def first_of(found: int, other: int) -> int:
    """Give the first finding of a fault; without one, whether the sample is suspect."""
    if found < 0 <= other:
        return other
    return found if found >= 0 else min(found, other)
