"""A sample of a rig on its way to the loop: calibrated, aligned, judged, and within its limits."""

from typing import NamedTuple

from seft_msgs_py.arrays import Floats, Ints
from seft_msgs_py.config.facts import CHANNELS

from seft_plant_sim.calibration import Calibration, CalibrationState, calibrate
from seft_plant_sim.channels import Derivation, derive_velocity
from seft_plant_sim.compiled import compiled
from seft_plant_sim.judge.detector_step import begin_detectors, judge_sample
from seft_plant_sim.judge.detectors import VALID, DetectorParameters, DetectorState
from seft_plant_sim.judge.servo_model import (
    AccelerationParameters,
    AccelerationState,
    begin_acceleration,
    derive_acceleration,
    follow_displacement,
)
from seft_plant_sim.limits import exceeds, is_exceeded

SUSPECT_ROW, DRIVE_ROW = 4, 5
"""Rows of a sample of rig/state after displacement, velocity, acceleration and force."""
PERSISTENT = 3
"""Samples in a row beyond a limit that end the test, of changes so many more as a jump shows in:
fewer are wrong samples, which are judged. A judged one beyond a limit ends the test at once, but
along the plan, which the force controller has."""
RANGES = {f"{name}_range": 1 << row for row, name in enumerate(CHANNELS)}
"""Bits of a step's result, by the channel that is saturated."""
OUTSIDE_LIMITS, BLIND, FAULT = 128, 256, 512
"""Bits of a step's result that end the test: samples as measured beyond a limit, sensors that are
saturated for too long, and a detector's finding."""
ENDS_TEST = OUTSIDE_LIMITS | BLIND | FAULT
_BLIND_SAMPLES, _OUTSIDE, _CHANGED, DETECTED = range(4)
"""Places of `GuardState.counts`."""


class GuardParameters(NamedTuple):
    """Parameters of the guard of n axes.

    Attributes
    ----------
    calibration : Calibration
        What is known of the channels.
    derivation : Derivation
        Of the velocity, if it is not measured.
    acceleration : AccelerationParameters
        Of the acceleration, likewise.
    range : ndarray
        Largest magnitude that each sensor can measure, shape (4, n); infinite if it is not known.
    limits : ndarray
        `Limits.values`, shape (8,).
    window : int
        Steps of a second.
    detectors : DetectorParameters
        Of faults, with the judge.
    """

    calibration: Calibration
    derivation: Derivation
    acceleration: AccelerationParameters
    range: Floats
    limits: Floats
    window: int
    detectors: DetectorParameters


class GuardState(NamedTuple):
    """State of a guard.

    Attributes
    ----------
    calibration : CalibrationState
        Of the channels.
    acceleration : AccelerationState
        Of a derived one.
    measured : ndarray
        The last sample as measured, calibrated and aligned, shape (4, n).
    recent, change, largest : ndarray
        See `exceeds`.
    blind : ndarray
        Ring buffer of the last steps at which a sensor was at its range.
    counts : ndarray
        Number of blind samples, of samples in a row beyond a limit, and beyond that of a change;
        what the detectors found, see `judge_sample`; shape (4,).
    detectors : DetectorState
        Of faults.
    """

    calibration: CalibrationState
    acceleration: AccelerationState
    measured: Floats
    recent: Floats
    change: Floats
    largest: Floats
    blind: Ints
    counts: Ints
    detectors: DetectorState


def begin_guard(parameters: GuardParameters, state: GuardState) -> None:
    """Begin a test."""
    state.counts[:] = 0
    state.largest[:] = 0.0
    begin_acceleration(state.acceleration)
    begin_detectors(parameters.detectors, state.detectors)


@compiled
def guard_step(
    parameters: GuardParameters,
    state: GuardState,
    step: int,
    measured: Floats,
    drive: Floats,
    sample: Floats,
) -> int:
    """Calibrate, align and judge a sample; look for faults, and at the limits.

    Parameters
    ----------
    parameters, state
        The state is updated.
    step : int
        Of the sample; samples follow one another from step 0 on.
    measured : ndarray
        What the sensors show, shape (4, n): displacement (m), velocity (m/s), acceleration (m/s^2)
        and force (N). It is calibrated and aligned in place.
    drive : ndarray
        What the rig applies from this sample on, shape (n,), V or N.
    sample : ndarray
        The judged sample, 1 where it is suspect, and the drive; shape (6, n). The result.

    Returns
    -------
    int
        Bits of `RANGES`, and those of `ENDS_TEST` if the test must end.
    """
    p, n, found = parameters, measured.shape[1], 0
    for row in range(4):
        for i in range(n):
            if abs(measured[row, i]) >= p.range[row, i]:
                found |= 1 << row
    if len(p.calibration.bias):
        calibrate(p.calibration, state.calibration, step, measured, measured)
    derive_velocity(p.derivation, step, state.measured, measured)
    derive_acceleration(p.acceleration, state.acceleration, step, drive, measured)
    counts, judged, is_blind = state.counts, sample[:4], found > 0
    beyond = exceeds(p.limits, step, state.recent, measured, state.change, state.largest)
    counts[_OUTSIDE] = counts[_OUTSIDE] + 1 if beyond & 1 else 0
    counts[_CHANGED] = counts[_CHANGED] + 1 if beyond & 2 else 0
    if counts[_OUTSIDE] >= PERSISTENT or counts[_CHANGED] >= PERSISTENT + len(state.recent):
        found |= OUTSIDE_LIMITS
    elif is_blind:
        if is_exceeded(state.blind, counts[_BLIND_SAMPLES], step, p.window):
            found |= BLIND
        counts[_BLIND_SAMPLES] += 1
    counts[DETECTED] = judge_sample(p.detectors, state.detectors, step, measured, drive, judged)
    follow_displacement(p.acceleration, state.acceleration, step, judged)
    if counts[DETECTED] >= 0:
        found |= FAULT
    for i in range(n):
        sample[SUSPECT_ROW, i] = 1.0 if counts[DETECTED] != VALID else 0.0
        sample[DRIVE_ROW, i] = drive[i]
        for row in range(4):
            state.measured[row, i] = measured[row, i]
    return found
