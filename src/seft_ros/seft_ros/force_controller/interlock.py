"""Interlock of the force control: what it must not compute with, and when it gives up."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.timebase import Timebase
from seft_plant_sim.saturated_time import TimeWithinSecond

from seft_ros.force_controller.force_control import ForceControl

Floats = npt.NDArray[np.float64]


class Interlock:
    """A `ForceControl` that never computes with nonsense, nor stays at its limit for long.

    Once it has tripped it answers 0 V, which closes the valve, until the next test.

    Parameters
    ----------
    controller : ForceControl
        Computes the valve drive.
    axes : sequence of str
        Names of the n axes.
    largest_force : float
        Magnitude of the reference force beyond which it is nonsense, N.
    longest_saturation : float
        Time within one second that the valve drive may be at its limit, s.
    dt : float
        Sampling period, s.

    Attributes
    ----------
    reason : str
        Why it has tripped, one line; empty while it has not.
    step_index : int
        Step at which it tripped; -1 while it has not.
    controller, largest
        As given; the force is ``largest_force``.
    saturated : TimeWithinSecond
        Time at the limit.
    """

    def __init__(
        self,
        controller: ForceControl,
        axes: Sequence[str],
        largest_force: float,
        longest_saturation: float,
        dt: float,
    ) -> None:
        self.controller = controller
        self._axes = tuple(axes)
        self.largest = largest_force
        self._safe_square = 0.99 * largest_force * largest_force
        self._longest = longest_saturation
        self.saturated = TimeWithinSecond(longest_saturation, dt)
        self._safe = np.zeros(len(self._axes))
        self.reset()

    @classmethod
    def from_parameters(
        cls,
        controller: ForceControl,
        section: dict[str, Any],
        axes: tuple[str, ...],
        timebase: Timebase,
    ) -> "Interlock":
        """Make it of the force controller's section of an experiment."""
        longest = section["watchdog.saturation_time"]
        return cls(controller, axes, section["limits.force"], longest, timebase.dt)

    def reset(self) -> None:
        """Forget the test so far, a trip too: before a new test."""
        self.controller.reset()
        self.saturated.reset()
        self.reason = ""
        self.step_index = -1

    def step(self, index: int, points: Floats, state: Floats) -> Floats:
        """Compute the valve drive of one step.

        Parameters
        ----------
        index : int
            The step.
        points : ndarray
            As to `ForceControl.step`.
        state : ndarray
            Measured displacement, velocity, acceleration and force, shape (4, n).

        Returns
        -------
        ndarray
            Valve drive, shape (n,), V; zero once it has tripped.
        """
        if self.reason:
            return self._safe
        force, measured = points[0, -1], state[3]
        if points.shape[1] > 1:  # a target is held against the motion, too
            measured = state.ravel()
        # a product with what is no number is none
        if not (force.dot(force) < self._safe_square and math.isfinite(measured.dot(measured))):
            nonsense = self.nonsense_in(points, state)
            if nonsense:
                self.trip(index, nonsense)
                return self._safe
        drive = self.controller.step(points, state)
        if not math.isfinite(drive.dot(drive)):
            self.trip(index, self._not_a_number("valve command", drive))
            return self._safe
        if self.controller.limited and self.saturated.is_exceeded(index):
            self.trip(index, self.saturation())
            return self._safe
        return drive

    def trip(self, index: int, reason: str) -> None:
        """Answer 0 V from now on; the first reason counts."""
        if not self.reason:
            self.reason, self.step_index = reason, index

    def saturation(self) -> str:
        """Say that the valve has been at its limit for too long."""
        return (
            f"the valve command is at its limit for more than {self._longest:g} s within one "
            "second: the force is out of control"
        )

    def nonsense_in(self, points: Floats, state: Floats) -> str:
        """Say what is wrong with a reference force, or with what is measured; else empty."""
        found = self.nonsense(points[0, -1]) or self._not_a_number("measured force", state[3])
        if points.shape[1] > 1:
            for row, name in enumerate(("displacement", "velocity", "acceleration")):
                found = found or self._not_a_number(f"measured {name}", state[row])
        return found

    def nonsense(self, reference_force: Floats) -> str:
        """Say what is wrong with a reference force, shape (n,), if anything; else empty."""
        for axis, value in zip(self._axes, reference_force.tolist(), strict=True):
            if abs(value) > self.largest:
                return (
                    f"reference force {value:.5g} N on axis {axis} is beyond the limit of "
                    f"{self.largest:g} N"
                )
        return self._not_a_number("reference force", reference_force)

    def _not_a_number(self, name: str, values: Floats) -> str:
        for axis, value in zip(self._axes, values.tolist(), strict=True):
            if not math.isfinite(value):
                return f"{name} on axis {axis} is {value}"
        return ""
