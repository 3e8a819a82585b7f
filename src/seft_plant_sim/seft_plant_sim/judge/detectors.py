"""Detectors of faulty sensors, valves and supplies: their thresholds and their arrays."""

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats, Ints, zeros
from seft_msgs_py.config.facts import CHANNELS, FORCE_DRIVEN, POSITION_SERVO
from seft_msgs_py.errors import InputError

from seft_plant_sim import channels
from seft_plant_sim.calibration import MAX_BIAS, known_channels
from seft_plant_sim.channels import ACCELERATION, Derivation, acceleration_is_derived, per_channel
from seft_plant_sim.compiled import compiled
from seft_plant_sim.judge import known_rig, valve_following
from seft_plant_sim.judge.detector_list import ALL, DETECTORS, TRACKING, Detector
from seft_plant_sim.judge.judge import BIAS, JudgeParameters, JudgeState, judge_arrays
from seft_plant_sim.judge.known_rig import CAPACITY, FLOW_GAIN, LEAKAGE, OIL_STIFFNESS
from seft_plant_sim.judge.relation_following import ESTIMATE_DRIFT, NOISE_SIGMAS
from seft_plant_sim.judge.servo_model import last_periods
from seft_plant_sim.judge.valve_model import valve_models

_MEMORY, _OIL_MEMORY = 0.05, 0.2
"""Time constants of the sums of both sides of relations (1) and (2), and of (3), s: to longer sums
the displacement adds no noise, as velocity and acceleration do."""
SHORT, FEWEST = 0.015, 7.0
"""Time constant of the sums of the second-order work, s, and its least value in samples."""
MOTION_MEMORY = 0.3
"""Time constant of the memory of the largest motion, and of the mean that gives a bias, s: a
quarter of a cycle at 1 Hz."""
TOLERANCES = np.array([0.1, 0.1, 0.35])
"""Largest difference of relations (1) to (3) over the motion: calibration and channels 2 ms apart
at 7 Hz; a flow gain with an error of 0.3, which the controller corrects."""
UNDESCRIBED = np.array([0.02, 0.02, 0.1])
"""Part of these that gain, delay and bias do not describe, at the beginning: a sensor's linearity,
a valve's, and the piston's friction."""
CHANNELS_APART = 2e-3
"""Largest time by which two channels are apart, s."""
NULL = 0.03
"""Standard deviation of a valve's null, over its full flow (servo-valves of a test's accuracy)."""
ASSUMED_NOISE = 1e-3
"""RMS noise of a sensor whose noise is not configured, over the limit of its channel."""


class KnownRig(NamedTuple):
    """What is known of a rig of n axes; arrays of shape (n,) if nothing else is said."""

    noise: Floats  # RMS of displacement, velocity, acceleration and force, (4, n); 0: not known
    limits: Floats  # their largest values, (4,)
    ranges: Floats  # largest values that the sensors can measure, (4, n); 0: not known
    steps: Floats  # of their converters, (4, n); 0: not known
    velocity_is_derived: bool  # from the displacement
    derivation: Derivation  # how it is
    actuator: Floats  # flow gain, oil stiffness, leakage, force capacity, (n, 4); 0: not known
    past: Floats  # part of past commands, the newest first, in the mean flow of the last period,
    # and its change per delay (1/s), (n, 2, m); of a servo, mean velocity
    imposes: bool  # whether a servo imposes the motion, whatever force and oil are
    has_valve: bool  # else the rig obeys the reference force, which it holds
    mass: Floats  # of the specimen, (n, n), kg
    stiffness: Floats  # likewise, N/m
    largest_drive: float  # of a valve, V: it is open then
    waits: Ints  # samples for which a channel repeats its first one, see `calibration`, (4,)
    dt: float  # sampling period, s


class DetectorParameters(NamedTuple):
    """Parameters of the detectors; D is their number."""

    rig: KnownRig  # a force capacity or a range that is not known is infinite
    fade: float  # factor per step with which sums fade
    oil_fade: float  # of the sums of relation (3)
    short: float  # of the second-order work
    memory: float  # of the largest motion
    by_force: Floats  # jump of the acceleration by that of a held force, (n, n), 1/kg; 0: a valve
    noise: Floats  # RMS, as assumed, (4, n)
    sums: Floats  # noise of the differences of relations (1) to (3), `NOISE_SIGMAS` times RMS,
    # (3, n); infinite where not watched
    deviation: Floats  # of gain, delay (s) and bias of each relation at the beginning, (3, 3, n)
    most: Floats  # largest values of these
    drift: Floats  # growth of their variances in a step
    correlated: Floats  # so many samples of each relation count as one, (3,)
    late: float  # time by which a derived velocity is late, s; 0: it is measured
    still: Floats  # noise of a change of x less what v expects, `NOISE_SIGMAS` times RMS, (n,), m
    rough: Floats  # likewise of the second difference of r, (n,), N
    unknown: float  # 0; infinite if the specimen is not known
    persistence: Ints  # samples for which a detector must be beyond its threshold, (D,)
    acts: Ints  # whether it ends the test, (D,); 0: it only warns
    judge: JudgeParameters


class DetectorState(NamedTuple):
    """State of the detectors: arrays of zeros."""

    last: Annotated[Floats, 4, "n"]  # the last sample
    flow: Annotated[Floats, 2, "n"]  # mean of the valve without load since then, m/s, and its
    # change per delay, m/s^2
    estimated: Annotated[Floats, 3, 3, "n"]  # gain, delay, bias of (1) to (3)
    covariance: Annotated[Floats, 3, "n", 3, 3]  # of these
    scatter: Annotated[Floats, 3, 2, "n"]  # see `remember`
    sent: Annotated[Floats, "n", "m"]  # past commands, the newest first, V
    sums: Annotated[Floats, 3, 4, "n"]  # of (1) to (3), see `relation_following`
    rise: Annotated[Floats, 3, "n"]  # last change of a, largest recent change of that, and sum of
    # the jumps by a held force, m/s^2
    largest: Annotated[Floats, 4, "n"]  # recent values of these sums, and of r
    restoring: Annotated[Floats, 2, "n"]  # r at the last sample, and now, N
    changes: Annotated[Floats, "n", 2, 2]  # of r, N, and x, m, in the last two periods
    work: Annotated[Floats, 3]  # sums of dr dx, of dx K dx and of squares of its noise
    farthest: Annotated[Floats, 2, "n"]  # displacement in both directions, see `look_at_strength`
    carried: Annotated[Floats, 2, 2]  # x K x there, N m, and the force, sqrt(N m)
    repeats: Annotated[Ints, 4, "n"]  # of the last value of a channel
    mean: Annotated[Floats, 2, "n"]  # that flow under the last load, as expected, and its variance
    counts: Annotated[Ints, "D", "n"]  # samples for which each has been beyond its threshold
    shares: Annotated[Floats, "D", "n"]  # largest part of its threshold that each has reached
    found: Annotated[Floats, 2, "D", "n"]  # value of each when it last acted, and its threshold
    step: Annotated[Ints, 6]  # of the last sample, turn of the motion, and end of each range
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
    if detector.lasts is None:
        return 1
    return max(3 if detector.lasts else 2, math.ceil(detector.lasts / dt - 1e-9))


def detector_arrays(
    known: KnownRig, warn_only: Sequence[str], zeroed: Mapping[str, Any] | None = None
) -> tuple[DetectorParameters, DetectorState]:
    """Put the detectors of a rig into arrays; some only warn.

    ``zeroed`` is what the rig measured at rest, see `seft_plant_sim.calibration.zeroed_at_rest`.
    """
    noise, limits, dt, mass = known.noise, known.limits, known.dt, known.mass
    has_valve, velocity_is_derived = known.has_valve, known.velocity_is_derived
    n, fade, oil_fade = noise.shape[1], fade_of_sums(dt), math.exp(-dt / _OIL_MEMORY)
    assumed = x, v, a, f = assumed_noise(noise, limits, velocity_is_derived, dt)
    actuator, ranges = known.actuator.copy(), np.where(known.ranges > 0.0, known.ranges, np.inf)
    if known.imposes:
        actuator[:] = 1.0, np.inf, 0.0, np.inf
    is_known = has_valve & (actuator[:, FLOW_GAIN] > 0.0) & (actuator[:, OIL_STIFFNESS] > 0.0)
    actuator[~is_known, OIL_STIFFNESS] = 1.0
    actuator[actuator[:, CAPACITY] <= 0.0, CAPACITY] = np.inf
    oil = np.where(is_known, f / actuator[:, OIL_STIFFNESS], np.inf)
    sums = np.array([noise_of_sums(x, dt * v, dt), noise_of_sums(v, dt * a, dt)])
    of_oil = np.hypot(x, oil) * math.sqrt(2.0 / (1.0 + oil_fade))
    late = valve_following.UNCERTAIN_DELAY if velocity_is_derived else 0.0
    has_oil = is_known & (not known.imposes)
    null = np.where(has_oil, NULL * actuator[:, FLOW_GAIN] * known.largest_drive, 0.0)
    deviation, most = _uncertain_relations(v, a, null, late)
    unknown = 0.0 if mass.any() and known.stiffness.any() else math.inf
    by_force = np.zeros_like(mass) if has_valve or not mass.any() else np.linalg.inv(mass)
    judging, judged = judge_arrays(
        assumed,
        _at_rest(assumed, limits, zeroed),
        np.transpose([np.where(has_oil, actuator[:, OIL_STIFFNESS], 0.0), actuator[:, LEAKAGE]]),
        mass,
        known.stiffness,
        ranges,
        np.where(known.steps > 0.0, known.steps, np.inf),
        late,
        known.derivation,
        np.full(n, int(known.imposes)),
        dt,
    )
    parameters = DetectorParameters(
        rig=known._replace(actuator=actuator, ranges=ranges),
        fade=fade,
        oil_fade=oil_fade,
        short=math.exp(-1.0 / max(SHORT / dt, FEWEST)),
        memory=math.exp(-dt / MOTION_MEMORY),
        by_force=by_force,
        noise=assumed,
        sums=NOISE_SIGMAS * np.vstack([sums, of_oil]),
        deviation=deviation,
        most=most,
        drift=(ESTIMATE_DRIFT * deviation) ** 2 * dt,
        correlated=np.maximum(1.0, np.array([_MEMORY, _MEMORY, _OIL_MEMORY]) / dt),
        late=late,
        still=NOISE_SIGMAS * np.hypot(math.sqrt(2.0) * x, dt * v / math.sqrt(2.0)),
        rough=NOISE_SIGMAS * np.sqrt(6.0 * (f**2 + mass**2 @ a**2)) + unknown,
        unknown=unknown,
        persistence=np.array([persistence_of(each, dt) for each in DETECTORS]),
        acts=np.array([each.name not in warn_only for each in DETECTORS], dtype=np.int64),
        judge=judging,
    )
    sizes = {"n": n, "m": known.past.shape[2], "D": len(DETECTORS)}
    return parameters, zeros(DetectorState, sizes, judge=judged)


def _uncertain_relations(v: Floats, a: Floats, null: Floats, late: float) -> tuple[Floats, Floats]:
    """Deviation of gain, delay and bias of relations (1) to (3) at the beginning, and the most.

    Of n axes with a noise ``v`` and ``a``, and a deviation ``null`` of the valve's null; each
    (3, 3, n).
    """
    one = np.ones_like(v)
    gain, delay = valve_following.LARGEST_GAIN_ERROR, valve_following.LARGEST_DELAY_ERROR
    apart = (CHANNELS_APART + late) * one
    kinematic = (TOLERANCES[0] * one, apart, BIAS * v), (TOLERANCES[1] * one, apart, BIAS * a)
    most = np.array([*kinematic, (gain * one, delay * one, NOISE_SIGMAS * null)])
    deviation = most.copy()
    deviation[:2, :2] /= NOISE_SIGMAS
    deviation[2] = valve_following.UNCERTAIN_GAIN * one, valve_following.UNCERTAIN_DELAY * one, null
    return deviation, most


def _at_rest(noise: Floats, limits: Floats, zeroed: Mapping[str, Any] | None) -> Floats:
    """Mean and standard deviation of the channels before step 0, shape (2, 4, n)."""
    if zeroed is None:
        return np.array([np.zeros_like(noise), np.hypot(noise, MAX_BIAS * limits[:, np.newaxis])])
    left = np.array([zeroed["left"][name] for name in CHANNELS])
    return np.array([left, math.sqrt(1.0 + BIAS * BIAS) * noise])


SAMPLE, TURN_AT, AT_RANGE = range(3)
"""Places of `DetectorState.step`."""
DISPLACEMENT_VELOCITY, VELOCITY_ACCELERATION, OIL = range(3)
"""Relations (1) to (3)."""
DIFFERS, SECOND_ORDER_WORK, WEAKENS, JUMP, FROZEN, WRONG = 0, 3, 4, 5, 6, 10
"""Rows of the detectors: sums of three relations, ..., four frozen and four wrong channels."""


@compiled
def look(
    p: DetectorParameters, state: DetectorState, row: int, i: int, seen: float, threshold: float
) -> int:
    """Compare a detector's value with its threshold; give it if that has persisted and it acts."""
    if 0.0 < threshold < np.inf and seen > state.shares[row, i] * threshold:  # no division
        state.shares[row, i] = seen / threshold
    count = state.counts[row, i]
    state.counts[row, i] = count = count + 1 if seen > threshold > 0.0 else max(count - 1, 0)
    if count >= p.persistence[row] and p.acts[row]:
        state.found[0, row, i], state.found[1, row, i] = seen, threshold
        return row * state.counts.shape[1] + i
    return VALID


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


def warning_detectors(section: Mapping[str, Any]) -> list[str]:
    """Give the names of the detectors that do not end a test, of a section.

    Raises
    ------
    InputError
        If there is no detector of a given name.
    """
    names = [one.name for one in (*DETECTORS, TRACKING)]
    listed = section["detectors.warn_only"].replace(",", " ").split()
    for name in listed:
        if name not in (*names, ALL):
            there = ", ".join(names)
            raise InputError(f"rig: detectors.warn_only: no detector {name!r}; there are {there}")
    return names if ALL in listed else listed


def detectors_of(
    section: dict[str, Any],
    axes: tuple[str, ...],
    dt: float,
    places: Sequence[int],
    zeroed: Mapping[str, Any] | None = None,
) -> tuple[DetectorParameters, DetectorState]:
    """Put the detectors of some of the axes into arrays.

    Parameters
    ----------
    section : dict
        Of the rig, for all axes.
    axes : tuple of str
        Names of all axes.
    dt : float
        Sampling period, s.
    places : sequence of int
        Of the watched axes.
    zeroed : mapping, optional
        What they measured at rest, see `seft_plant_sim.calibration.zeroed_at_rest`.

    Raises
    ------
    InputError
        If assumed values do not fit the axes, or there is no detector of a given name.
    """
    own, warn_only = list(places), warning_detectors(section)
    actuator = known_rig.read_actuators(section, axes, places)
    is_known = actuator["valve_frequency"] > 0.0
    is_known &= section["actuator.kind"] != POSITION_SERVO  # its valve obeys no command of ours
    actuator["flow_gain"] = np.where(is_known, actuator["flow_gain"], 0.0)
    actuator["valve_frequency"] = np.where(is_known, actuator["valve_frequency"], 1.0 / dt)
    mass, stiffness = known_rig.read_specimen(section, axes, places)
    past = np.array([valve.last_period() for valve in valve_models(actuator, dt)])
    imposes = section["actuator.kind"] == POSITION_SERVO
    imposes = imposes and bool(np.any(section["actuator.response.numerator"]))
    if imposes:
        past = last_periods(section, known_rig.known_responses(section, axes, own))
    noise = np.ascontiguousarray(per_channel(section, axes, "sensors.{}_noise")[:, own])
    ranges = np.ascontiguousarray(per_channel(section, axes, "sensors.{}_range")[:, own])
    if acceleration_is_derived(section):  # nothing else is compared with it, and no sensor ends it
        noise[ACCELERATION], ranges[ACCELERATION] = section["limits.acceleration"], 0.0
        mass, stiffness = np.zeros_like(mass), np.zeros_like(stiffness)
    bits = section["sensors.adc_bits"]
    shown = known_channels(section, axes, ("bias", "scale", "lag"))  # a range is of what is shown
    bias, scale, late = np.abs(shown["bias"][:, own]), np.abs(shown["scale"][:, own]), shown["lag"]
    known = KnownRig(
        noise=noise,
        limits=np.array([section[f"limits.{name}"] for name in CHANNELS]),
        ranges=(ranges - bias) / scale,
        steps=ranges * (2.0 ** (1 - bits) if bits else 0.0) / scale,
        velocity_is_derived=channels.velocity_is_derived(section),
        derivation=Derivation.from_parameters(section, dt),
        actuator=np.transpose([actuator[name] for name in known_rig.ASSUMED_ACTUATOR]),
        past=past,
        imposes=imposes,
        has_valve=section["actuator.kind"] not in FORCE_DRIVEN,
        mass=mass,
        stiffness=stiffness,
        largest_drive=known_rig.command_limit(section),
        waits=np.ceil((late.max() - late[:, own]).max(axis=1) / dt).astype(np.int64),
        dt=dt,
    )
    return detector_arrays(known, warn_only, zeroed)
