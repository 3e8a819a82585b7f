"""The guard of a rig: it calibrates, aligns and judges each sample, and ends a test at a fault."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.facts import CHANNELS
from seft_msgs_py.config.parameter_table import group
from seft_msgs_py.wire.topics import RigAxes

from seft_plant_sim.calibration import Calibration, CalibrationState, calibration_of
from seft_plant_sim.channels import Derivation, converters, velocity_is_derived
from seft_plant_sim.compiled import entry_point
from seft_plant_sim.judge.detection import detectors_of
from seft_plant_sim.judge.detector_list import DETECTORS, describe
from seft_plant_sim.judge.detectors import DetectorParameters, DetectorState
from seft_plant_sim.judge.guard_step import (
    DETECTED,
    DRIVE_ROW,
    ENDS_TEST,
    FAULT,
    OUTSIDE_LIMITS,
    RANGES,
    GuardParameters,
    GuardState,
    begin_guard,
    guard_step,
)
from seft_plant_sim.judge.servo_model import (
    AccelerationParameters,
    AccelerationState,
    acceleration_of,
)
from seft_plant_sim.limits import Limits, event_ring


class Guard:
    """What the samples of a rig pass before anything uses them, see `guard_step`.

    Parameters
    ----------
    calibration : tuple of Calibration and CalibrationState
        What is known of the channels.
    derivation : Derivation
        Of the velocity, if it is not measured.
    acceleration : tuple of AccelerationParameters and AccelerationState
        Of the acceleration, likewise.
    ranges : ndarray
        Largest magnitude that each sensor can measure, shape (4, n).
    limits : Limits
        Of the samples.
    saturated_time : float
        Time within one second that sensors may be saturated, s.
    detectors : tuple of DetectorParameters and DetectorState
        Of faults.
    axes : sequence of str
        Names of the n axes.

    Attributes
    ----------
    limits : Limits
        As given.
    parameters, state : GuardParameters, GuardState
        Arguments of `guard_step`, here and in a compiled loop.
    """

    def __init__(
        self,
        calibration: tuple[Calibration, CalibrationState],
        derivation: Derivation,
        acceleration: tuple[AccelerationParameters, AccelerationState],
        ranges: Floats,
        limits: Limits,
        saturated_time: float,
        detectors: tuple[DetectorParameters, DetectorState],
        axes: Sequence[str],
    ) -> None:
        self.limits, self._axes, self._saturated_time = limits, tuple(axes), saturated_time
        n, dt = len(self._axes), detectors[0].dt
        blind, window = event_ring(saturated_time, dt)
        self.parameters = GuardParameters(
            calibration[0],
            derivation,
            acceleration[0],
            ranges,
            limits.values,
            window,
            detectors[0],
        )
        self.state = GuardState(
            calibration=calibration[1],
            acceleration=acceleration[1],
            measured=np.zeros((4, n)),
            recent=limits.recent,
            change=limits.change,
            largest=limits.largest,
            blind=blind,
            counts=np.zeros(4, dtype=np.int64),
            detectors=detectors[1],
        )
        both, sample = (self.parameters, self.state), np.zeros((DRIVE_ROW + 1, n))
        self._begin = entry_point(begin_guard, *both)
        self._step = entry_point(guard_step, *both, 0, np.zeros((4, n)), sample[0], sample)

    @classmethod
    def from_parameters(
        cls, section: dict[str, Any], axes: tuple[str, ...], rig: RigAxes, dt: float
    ) -> "Guard":
        """Make it from the rig's section of an experiment, which is for all axes.

        Raises
        ------
        InputError
            If sizes do not fit the axes, or what is known of the channels makes no sense.
        """
        ranges, resolution = converters(section, axes, rig.places, "sensors.adc_bits")
        derived = velocity_is_derived(section)
        return cls(
            calibration_of(section, axes, rig.places, dt, ranges, resolution, derived),
            Derivation.from_parameters(section, dt),
            acceleration_of(section, axes, rig.places, dt),
            ranges,
            Limits(group(section, "limits"), rig.axes, dt),
            section["limits.saturated_time"],
            detectors_of(section, axes, dt, rig.places),
            rig.axes,
        )

    @property
    def nearest(self) -> tuple[str, float]:
        """The detector nearest to its threshold in this test, and its value over the threshold."""
        shares = self.state.detectors.shares.max(axis=1)
        row = int(shares.argmax())
        return DETECTORS[row].name, float(shares[row])

    def reset(self) -> None:
        """Begin a new test."""
        self._begin(self.parameters, self.state)

    def take(self, step: int, measured: Floats, drive: Floats, sample: Floats) -> int:
        """Take a sample, see `guard_step`."""
        found: int = self._step(self.parameters, self.state, step, measured, drive, sample)
        return found

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
        return (
            f"{' and '.join(blind)} at the end of the sensor's range for more than "
            f"{self._saturated_time:g} s within one second: their channels are unknown"
        )
