"""Detectors of faulty sensors, valves and supplies: by name, their thresholds, and their arrays."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats, Ints
from seft_plant_sim.compiled import compiled
from seft_plant_sim.sensors import CHANNELS

from seft_ros.protection.judge import LASTS, JudgeParameters, JudgeState, judge_arrays
from seft_ros.protection.valve_following import UNCERTAIN_DELAY, doubt

LONG_LASTS = 0.02
"""Time for which some detectors must be beyond their thresholds, s: longer than the effects of a
specimen that slips or hits a stop, or of a valve at its limit. For the others it is `LASTS`."""

WARNING = 0.8
"""Part of its threshold at which a detector warns: noise alone reaches 0.75 in a test."""


@dataclass(frozen=True)
class Detector:
    """One of the detectors.

    Attributes
    ----------
    name : str
        Name in parameters and reports.
    text : str
        Its finding in a sentence, with the measured value and the threshold.
    unit : str
        Of both.
    lasts : float
        Persistence, s; three samples at least, because an event between two samples shows in both;
        0: two samples.
    of_valve : bool
        Whether it uses the flow of the commands, some of which a rig may have missed.
    """

    name: str
    text: str
    unit: str
    lasts: float = LASTS
    of_valve: bool = False


_SUMS = "disagree on axis {axis}: they differ by {seen} over the last 50 ms"
_STEP = "disagree on axis {axis} from sample to sample, as with noise: they differ by {seen}"
_OIL = "measured velocity and force, and the valve's flow by its commands,"
_SAME = "measured {} on axis {{axis}} has repeated one value for {{seen}}"
_WRONG = "measured {} on axis {{axis}} contradicts the other channels: {{seen}} within 50 ms"
DETECTORS = (
    Detector("displacement_velocity", f"measured displacement and velocity {_SUMS}", "m"),
    Detector("velocity_acceleration", f"measured velocity and acceleration {_SUMS}", "m/s"),
    Detector("oil_balance", f"{_OIL} {_SUMS}", "m", of_valve=True),
    Detector("oil_noise", f"{_OIL} {_STEP}", "m", of_valve=True),
    Detector(
        "second_order_work",
        "the measured force falls as the specimen is deformed further: work of {seen} against it",
        "N m",
    ),
    Detector(
        "force_noise",
        "measured force and acceleration disagree on axis {axis} from sample to sample, as with "
        "noise: the specimen's force alternated in {seen} recently",
        "samples",
        0.0,
    ),
    Detector(
        "force_jump",
        "the specimen's force by measured force and acceleration on axis {axis} jumps by {seen}",
        "N",
        0.0,
    ),
    Detector(
        "force_response",
        "measured force on axis {axis} does not answer the motion: sum of squares {seen}",
        "N^2",
        LONG_LASTS,
    ),
    Detector(
        "tracking",
        "measured displacement on axis {axis} is {seen} away from its target",
        "m",
        LONG_LASTS,
    ),
    *(Detector(f"{name}_frozen", _SAME.format(name), "samples", 0.0) for name in CHANNELS),
    *(Detector(f"{name}_wrong", _WRONG.format(name), "samples", 0.0) for name in CHANNELS),
)
"""In the order of the rows of a detector's arrays."""

MODEL_BASED = (
    *("oil_balance", "oil_noise", "second_order_work"),
    *("force_noise", "force_jump", "force_response"),
)
"""Detectors that need actuators or specimen: they only warn while these are being identified."""
NOISE_BASED = tuple(f"{name}_frozen" for name in CHANNELS)
"""Detectors that need the noise of the channels: a value with noise does not repeat."""
ALL = "all"


def describe(place: int, found: Floats, axes: Sequence[str]) -> str:
    """Describe a detector's finding in a sentence, from the results of `detect`."""
    row, axis = divmod(place, len(axes))
    one = DETECTORS[row]
    seen, threshold = (f"{value:.3g} {one.unit}" for value in found.tolist())
    return f"{one.text.format(axis=axes[axis], seen=seen)} ({threshold} allowed): {one.name}"


_MEMORY = 0.05
"""Time constant of the sums of both sides of a relation, s."""
SHORT, FEWEST = 0.015, 7.0
"""Time constant of short sums (of the second-order work, of noise), s, and its least value in
samples: with fewer, some friction looks like noise."""
BIAS = 2.0
"""Largest constant error of a sensor that is no fault, over its RMS noise."""
LARGEST = 0.3
"""Time constant of the memory of the largest motion, and of the mean that gives a bias, s: a
quarter of a cycle at 1 Hz."""
SIGMAS = 6.0
"""Threshold over the RMS of the noise alone."""
TOLERANCES = (0.1, 0.1, 0.35)
"""Largest difference of relations (1) to (3) over the motion: calibration and channels 2 ms apart
at 7 Hz; a flow gain with an error of 0.3, which the controller corrects."""
FOLLOWED_VALVES = 0.1
"""Largest difference of the flow from sample to sample, over the flow, once its gain is estimated:
effects of the valve that gain and delay do not describe, the piston's friction."""
OFF_TARGET = 0.5
"""Largest distance to the target over the target's motion."""
LIMITED = 0.1
"""Time after a command at the valve's limit in which the distance may be larger, s."""
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
    actuator : ndarray
        Flow gain, oil stiffness, leakage and force capacity, see `FeedforwardParameters`; (n, 4).
    past : ndarray
        Part of past commands in the present flow, the newest first, and its change per delay (1/s);
        shape (2, n, m).
    doubt : ndarray
        Variance of the measured flow, shape (n,), (m/s)^2, see `follow_valve`.
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
    limited : int
        Samples after one at the valve's limit in which the target need not be followed.
    sums, steps : ndarray
        Noise of the sums of the differences of relations (1) to (3), shape (3, n), and of those of
        relation (3) in a single step, shape (n,): `SIGMAS` times RMS; infinite where not watched.
    bias : ndarray
        Largest mean difference in a step that is no fault, shape (3, n).
    late : float
        Time by which a derived velocity is late, s; 0: it is measured.
    rough : ndarray
        Noise of the second difference of r, likewise, shape (n,), N.
    unknown : float
        0; infinite if the specimen is not known.
    tolerance : ndarray
        Part of the largest motion by which the sides of a relation may differ, shape (3,).
    off_target : float
        Largest distance of the specimen to the target, over the target's largest motion; infinite
        without a target.
    persistence : ndarray
        Samples for which a detector must be beyond its threshold, shape (D,).
    acts : ndarray
        Whether a detector ends the test, shape (D,); 0: it only warns.
    samples : ndarray
        Count of a sample that no held command explains, so that its detector needs no longer time
        than without held commands; shape (D,).
    judge : JudgeParameters
        Of the judge.
    """

    dt: float
    fade: float
    short: float
    memory: float
    actuator: Floats
    past: Floats
    doubt: Floats
    has_valve: bool
    mass: Floats
    stiffness: Floats
    by_force: Floats
    computed_mass: Floats
    noise: Floats
    dither: Floats
    range: Floats
    limited: int
    sums: Floats
    steps: Floats
    bias: Floats
    late: float
    rough: Floats
    unknown: float
    tolerance: Floats
    off_target: float
    persistence: Ints
    acts: Ints
    samples: Ints
    judge: JudgeParameters


class DetectorState(NamedTuple):
    """State of the detectors.

    Attributes
    ----------
    last : ndarray
        The last sample, shape (4, n).
    flow, later : ndarray
        Flow of the valve from the commands at the last sample and at this one, m/s, and its change
        per delay, m/s^2; shapes (2, n).
    errors, covariance : ndarray
        Of the estimated gain and delay, see `follow_valve`; shapes (n, 2) and (n, 3).
    sent : ndarray
        Past commands as they act under load, the newest first, shape (n, m), V.
    sums : ndarray
        Both sides of relations (1) to (3), and the least and the largest value of the left side if
        the rig holds a command; shape (3, 4, n).
    bias : ndarray
        Mean difference of the sides of relations (1) to (3) in the recent steps, and the part of
        the largest bias that this mean does not contain yet; shape (3, 2, n).
    flows : ndarray
        Left side of relation (3) of the last steps, for the time of a held command, the newest
        first, m; shape (n, h).
    rise : ndarray
        Sums of the acceleration's changes, and of its jumps by a held force, m/s^2, shape (2, n).
    largest : ndarray
        Largest recent values: of these sums, of a single step, of the target's motion, of r, and of
        the change of the flow in a step (m/s); shape (9, n).
    restoring : ndarray
        r at the last sample, its last change, and the present r; shape (3, n), N.
    work : ndarray
        Sums of dr dx, of dx K dx and of squares of its noise, shape (3,).
    response : ndarray
        Sums of squares of the changes of f and of M_c a, shape (2, n), N^2.
    bends : ndarray
        Second difference of r while it is beyond its threshold, N, and the recent frequency of its
        changes of sign; shape (2, n).
    repeats : ndarray
        Number of repetitions of the last value of a channel, shape (4, n).
    mean : ndarray
        Mean flow of the valves since the last sample, shape (n,), m/s.
    counts : ndarray
        Samples for which each detector has been beyond its threshold, shape (D, n).
    shares : ndarray
        Largest part of its threshold that each has reached, shape (D, n).
    found : ndarray
        Value of a detector when it tripped, and its threshold; shape (2,).
    step : ndarray
        Steps of the last sample, the last turn of the motion, the last command at the valve's
        limit and the last sample at the end of each channel's range, shape (7,); a large negative
        number at the beginning.
    judge : JudgeState
        Of the judge.
    """

    last: Floats
    flow: Floats
    later: Floats
    errors: Floats
    covariance: Floats
    sent: Floats
    sums: Floats
    bias: Floats
    flows: Floats
    rise: Floats
    largest: Floats
    restoring: Floats
    work: Floats
    response: Floats
    bends: Floats
    repeats: Ints
    mean: Floats
    counts: Ints
    shares: Floats
    found: Floats
    step: Ints
    judge: JudgeState


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
    longest_hold: float,
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
        See `DetectorParameters`; a flow gain or an oil stiffness of 0 is not known.
    has_valve : bool
        Whether these valves drive the rig.
    mass, stiffness, computed_mass : ndarray
        Shape (n, n), kg, N/m and kg.
    warn_only : sequence of str
        Names of the detectors that do not end a test.
    longest_hold : float
        Longest time for which a rig that misses commands holds the last one, s: no fault.
    dt : float
        Sampling period, s.
    """
    n, fade = noise.shape[1], math.exp(-dt / _MEMORY)
    short = math.exp(-1.0 / max(SHORT / dt, FEWEST))
    x, v, a, f = np.where(noise > 0.0, noise, ASSUMED_NOISE * limits[:, np.newaxis])
    if velocity_is_derived:
        v = math.sqrt(2.0) * x / dt
    known = has_valve & (actuator[:, 0] > 0.0) & (actuator[:, 1] > 0.0)
    actuator = actuator.copy()
    actuator[~known, 1] = 1.0
    actuator[actuator[:, 3] <= 0.0, 3] = np.inf
    oil = np.where(known, f / actuator[:, 1], np.inf)
    jumps, rates = np.array([x, v, oil]), dt * np.array([v, a, v])
    sums = np.sqrt(jumps**2 * 2.0 / (1.0 + fade) + rates**2 / (2.0 * (1.0 - fade)))
    unknown = 0.0 if mass.any() and stiffness.any() else math.inf
    by_force = np.zeros_like(mass) if has_valve or not mass.any() else np.linalg.inv(mass)
    spans = np.array([[each.lasts, longest_hold * each.of_valve] for each in DETECTORS])
    shortest, lasts = (
        np.maximum(2 + (spans[:, 0] > 0.0), np.ceil(span / dt - 1e-9).astype(np.int64))
        for span in (spans[:, 0], spans.sum(axis=1))
    )
    judging, judged = judge_arrays(
        np.array([x, v, a, f]),
        np.transpose([np.where(known, actuator[:, 1], 0.0), actuator[:, 2]]),
        mass,
        stiffness,
        np.where(ranges > 0.0, ranges, np.inf),
        UNCERTAIN_DELAY if velocity_is_derived else 0.0,
        SIGMAS,
        dt,
    )
    lasts[WRONG:] = 1  # they count by themselves
    acts = [each.name not in warn_only for each in DETECTORS]
    parameters = DetectorParameters(
        dt=dt,
        fade=fade,
        short=short,
        memory=math.exp(-dt / LARGEST),
        actuator=actuator,
        past=past,
        doubt=doubt(v, f, actuator[:, 1], dt),
        has_valve=has_valve,
        mass=mass,
        stiffness=stiffness,
        by_force=by_force,
        computed_mass=computed_mass,
        noise=np.array([x, v, a, f]),
        dither=noise,
        range=judging.range,
        limited=math.ceil(LIMITED / dt),
        sums=SIGMAS * sums,
        bias=BIAS * rates,
        late=judging.late,
        steps=SIGMAS * np.sqrt(2.0 * oil**2 + (dt * v) ** 2 / 2.0),
        rough=judging.noise[3] + unknown,
        unknown=unknown,
        tolerance=np.array(TOLERANCES),
        off_target=OFF_TARGET,
        persistence=lasts,
        acts=np.array(acts, dtype=np.int64),
        samples=-(-lasts // shortest),
        judge=judging,
    )
    state = DetectorState(
        last=np.zeros((4, n)),
        flow=np.zeros((2, n)),
        later=np.zeros((2, n)),
        errors=np.zeros((n, 2)),
        covariance=np.zeros((n, 3)),
        sent=np.zeros_like(past[0]),
        sums=np.zeros((3, 4, n)),
        bias=np.zeros((3, 2, n)),
        rise=np.zeros((2, n)),
        flows=np.zeros((n, 1 + math.ceil(longest_hold / dt - 1e-9))),
        largest=np.zeros((9, n)),
        restoring=np.zeros((3, n)),
        work=np.zeros(3),
        response=np.zeros((2, n)),
        bends=np.zeros((2, n)),
        repeats=np.zeros((4, n), dtype=np.int64),
        mean=np.zeros(n),
        counts=np.zeros((len(DETECTORS), n), dtype=np.int64),
        shares=np.zeros((len(DETECTORS), n)),
        found=np.zeros(2),
        step=np.zeros(7, dtype=np.int64),
        judge=judged,
    )
    return parameters, state


DISPLACEMENT, VELOCITY, ACCELERATION, FORCE_CHANNEL = range(4)
"""Rows of the channels."""
SAMPLE, TURN_AT, LIMITED_AT, AT_RANGE = range(4)
"""Places of `DetectorState.step`."""
DISPLACEMENT_VELOCITY, VELOCITY_ACCELERATION, OIL = range(3)
"""Relations (1) to (3)."""
CHANGE, OIL_NOISE, SECOND_ORDER_WORK, ROUGH, JUMP = 0, *range(3, 7)
NO_RESPONSE, TRACKING, FROZEN, WRONG = 7, 8, 9, 13
"""Rows of the detectors: sums of three relations, ..., four frozen and four wrong channels."""


@compiled
def look(
    p: DetectorParameters,
    state: DetectorState,
    row: int,
    i: int,
    seen: float,
    threshold: float,
    samples: int = 1,
) -> bool:
    """Compare a detector's value with its threshold; say whether it has persisted and acts.

    A sample beyond the threshold counts as ``samples`` samples.
    """
    share = seen / threshold if threshold > 0.0 else 0.0
    if share > state.shares[row, i]:
        state.shares[row, i] = share
    count = state.counts[row, i]
    state.counts[row, i] = count = count + samples if share > 1.0 else max(count - 1, 0)
    if count >= p.persistence[row] and p.acts[row]:
        state.found[0], state.found[1] = seen, threshold
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
