"""The guard of a rig: it calibrates, aligns and judges each sample, and ends a test at a fault."""

from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats, Ints, clear, zeros
from seft_msgs_py.config.facts import CHANNELS
from seft_msgs_py.config.parameter_table import group
from seft_msgs_py.wire.topics import RigAxes

from seft_plant_sim.calibration import Calibration, CalibrationState, calibrate, calibration_of
from seft_plant_sim.channels import VELOCITY, Derivation, converters, derive_velocity
from seft_plant_sim.compiled import compiled, entry_point
from seft_plant_sim.judge import detectors, servo_model
from seft_plant_sim.judge.detector_list import DETECTORS, describe
from seft_plant_sim.judge.detector_step import begin_detectors, judge_sample
from seft_plant_sim.judge.detectors import WRONG, DetectorParameters, DetectorState, detectors_of
from seft_plant_sim.judge.hypotheses import ANY_CHANNEL, FORCES
from seft_plant_sim.judge.judge import LASTS
from seft_plant_sim.limits import Limits, event_ring, exceeds, is_exceeded

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

FOUND_IN = 0.03
"""Time in which most faults are found that spoil the target, s: of 0 to 40 ms, that after which the
most faults of docs/faults.py come to rest in time."""


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
    acceleration: servo_model.AccelerationParameters
    range: Floats
    limits: Floats
    window: int
    detectors: DetectorParameters


class GuardState(NamedTuple):
    """State of a guard."""

    calibration: CalibrationState  # of the channels
    acceleration: servo_model.AccelerationState  # of a derived one
    measured: Annotated[Floats, 4, "n"]  # the last sample as measured, calibrated and aligned
    recent: Floats  # see `exceeds`
    change: Floats
    largest: Floats
    blind: Ints  # ring buffer of the last steps at which a sensor was at its range
    counts: Annotated[Ints, 4]  # number of blind samples, of samples in a row beyond a limit, and
    # beyond that of a change; what the detectors found, see `judge_sample`
    detectors: DetectorState  # of faults


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
    derive_velocity(p.derivation, step, state.detectors.last, measured)
    servo_model.derive_acceleration(p.acceleration, state.acceleration, step, drive, measured)
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
    servo_model.follow_displacement(p.acceleration, state.acceleration, step, judged)
    if counts[DETECTED] >= 0:
        found |= FAULT
    for i in range(n):
        sample[SUSPECT_ROW, i] = 1.0 if counts[DETECTED] != detectors.VALID else 0.0
        sample[DRIVE_ROW, i] = drive[i]
        for row in range(4):
            state.measured[row, i] = measured[row, i]
    return found


class Guard:
    """What the samples of a rig pass before anything uses them, see `guard_step`.

    Parameters
    ----------
    section, axes
        Of the rig in an experiment, which is for all axes, and the names of these.
    rig : RigAxes
        Which of the axes are its own.
    dt : float
        Period, s.
    zeroed : mapping, optional
        What it measured at rest, see `seft_plant_sim.calibration.zeroed_at_rest`.

    Raises
    ------
    InputError
        If sizes do not fit the axes, or what is known of the channels makes no sense.

    Attributes
    ----------
    limits : Limits
        Of the samples.
    parameters, state : GuardParameters, GuardState
        Arguments of `guard_step`, here and in a compiled loop.
    """

    def __init__(
        self,
        section: dict[str, Any],
        axes: tuple[str, ...],
        rig: RigAxes,
        dt: float,
        zeroed: Mapping[str, Any] | None = None,
    ) -> None:
        places = rig.places
        ranges, resolution = converters(section, axes, places, "sensors.adc_bits")
        calibration = calibration_of(section, axes, places, dt, ranges, resolution)
        derivation = Derivation.from_parameters(section, dt)
        acceleration = servo_model.acceleration_of(section, axes, places, dt)
        limits = Limits(group(section, "limits"), rig.axes, dt)
        detecting = detectors_of(section, axes, dt, places, zeroed)
        self.limits, self._axes, self._dt = limits, rig.axes, dt
        self._saturated_time: float = section["limits.saturated_time"]
        n, (blind, window) = len(rig.axes), event_ring(self._saturated_time, dt)
        self.parameters = GuardParameters(
            calibration[0], derivation, acceleration[0], ranges, limits.values, window, detecting[0]
        )
        made = {"calibration": calibration[1], "acceleration": acceleration[1], "blind": blind}
        made |= {name: getattr(limits, name) for name in ("recent", "change", "largest")}
        self.state = zeros(GuardState, {"n": n}, detectors=detecting[1], **made)
        both, sample = (self.parameters, self.state), np.zeros((DRIVE_ROW + 1, n))
        self._step = entry_point(guard_step, *both, 0, np.zeros((4, n)), sample[0], sample)

    @property
    def nearest(self) -> tuple[str, float]:
        """The detector nearest to its threshold in this test, and its value over the threshold."""
        shares = self.state.detectors.shares.max(axis=1)
        row = int(shares.argmax())
        return DETECTORS[row].name, float(shares[row])

    def reset(self) -> None:
        """Begin a new test."""
        clear(self.state[:-1])
        begin_detectors(self.parameters.detectors, self.state.detectors)

    def take(self, step: int, measured: Floats, drive: Floats, sample: Floats) -> int:
        """Take a sample, see `guard_step`."""
        found: int = self._step(self.parameters, self.state, step, measured, drive, sample)
        return found

    def trusted(self, found: int) -> int:
        """Give the last step up to which no wrong value was used, as far as is known; -1: none.

        ``found`` is the result of the step that ends the test. What stands still, and what was
        wrong, or an event, in all samples from one on, began there; anything else before it was
        found. The others tell a displacement or velocity that is wrong, so that it is not used. But
        if a velocity is off by less than displacements show, force and acceleration may be wrong.
        """
        row, judge = int(self.state.counts[DETECTED]) // len(self._axes), self.state.detectors.judge
        last, replaced = int(judge.step[0]), (judge.sets & ANY_CHANNEL).any()
        if not (found & FAULT or replaced):
            return -1
        seen = self._dt * np.abs(self.state.measured - self.state.detectors.last)[VELOCITY]
        unsure = ((seen > 0.0) & (seen < 2.0 * self.parameters.detectors.still)).any()
        if (row >= WRONG or not found & FAULT) and not (unsure or (judge.sets & FORCES).any()):
            return last
        odd = [age for age in range(len(judge.sets)) if judge.sets[judge.place[0] - age].any()]
        since = 1 + max(odd, default=0)
        if found & FAULT and detectors.FROZEN <= row < WRONG:
            since = max(since, 1 + int(self.state.detectors.repeats.max()))
        elif len(odd) < since:
            since = max(since, round(FOUND_IN / self._dt))
        return last - since - max(2, round(LASTS / self._dt))  # one may have been accepted before

    def violation(self, found: int) -> str | None:
        """Say why the test must end with the last sample; ``found`` is the result of its step."""
        if not found & ENDS_TEST:
            return None
        limits, state = self.limits, self.state
        if found & FAULT:
            row, axis = divmod(int(state.counts[DETECTED]), len(self._axes))
            found_there = state.detectors.found[:, row, axis]
            return describe(DETECTORS[row], found_there, self._axes[axis])
        if found & OUTSIDE_LIMITS:
            return limits.describe(state.measured)
        blind = sorted(name for name in CHANNELS if found & RANGES[f"{name}_range"])
        most = f"{self._saturated_time:g} s within one second: their channels are unknown"
        return f"{' and '.join(blind)} at the end of the sensor's range for more than {most}"
