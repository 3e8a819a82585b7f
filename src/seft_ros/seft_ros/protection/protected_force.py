"""The reference force with its protection: instability watch, plausibility, ramp-down."""

from collections import deque
from collections.abc import Hashable, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats, clear, zeros
from seft_msgs_py.config.parameter_table import group
from seft_msgs_py.wire.topics import Timebase
from seft_plant_sim.compiled import entry_point, kind_of
from seft_plant_sim.limits import largest_force_rate

from seft_ros.protection.instability import InstabilityWatch
from seft_ros.protection.protection_step import (
    CAUSE,
    HOLDING,
    IMPLAUSIBLE_FORCE,
    IMPLAUSIBLE_STATE,
    INSTABILITY,
    NOTHING,
    PlausibleForce,
    ProtectionParameters,
    ProtectionState,
    RampDown,
    begin_step,
    not_finite,
    protect,
)
from seft_ros.reference_force.compensator import has_computed_model
from seft_ros.reference_force.reference_force_block import ReferenceForce


class ProtectedForce:
    """A `ReferenceForce` that is checked in each step, and is ramped down after a fault.

    Without a fault or a ramp it gives exactly the force of the block. In the ramp the force
    continues to follow the test, scaled down; a target is slowed down to rest instead. An
    implausible force is never given: the last plausible one replaces it, extrapolated and scaled
    down.

    In a loop with a delay of d steps, the force that is computed from the state of step k is for
    step k + d, and the points are the final forces of the steps k to k + d: the next message
    replaces a late or lost one. A target's points contain its future motion in any case.

    Parameters
    ----------
    reference_force : ReferenceForce
        The block.
    plausible : PlausibleForce
        Limits of its force.
    watch : InstabilityWatch
        May begin the ramp, too.
    ramp : RampDown
        The ramp.
    loop_delay : int
        d.

    Attributes
    ----------
    preview : int
        Number of later steps whose ground motion `step` needs.
    reference_force : ReferenceForce
        As given.
    ramp : RampDown
        As given; at rest, the applied force is zero and stays there.
    parameters, state : ProtectionParameters, ProtectionState
        Arguments of `protect`, here and in a compiled loop.
    """

    def __init__(
        self,
        reference_force: ReferenceForce,
        plausible: PlausibleForce,
        watch: InstabilityWatch,
        ramp: RampDown,
        loop_delay: int = 0,
    ) -> None:
        self.preview = reference_force.preview
        self.estimates = reference_force.estimates
        self.reference_force = reference_force
        self._plausible, self._watch, self.ramp = plausible, watch, ramp
        self._axes, provides_target = len(plausible.axes), reference_force.provides_target
        self._settled: deque[Floats] | None = None  # of the last steps
        if loop_delay and not provides_target:
            self._settled = deque(maxlen=1 + loop_delay)
        self._points = np.zeros((*reference_force.shape, self._axes))
        self.parameters = ProtectionParameters(
            plausible.limits, ramp.steps, provides_target, plausible.dt, watch.parameters
        )
        sizes = {"quantities": reference_force.shape[1], "n": self._axes}
        given = {"ramp": ramp.state, "recent": plausible.recent, "watch": watch.state}
        self.state = zeros(ProtectionState, sizes, **given)
        both = self.parameters, self.state
        self._begin_step = entry_point(begin_step, *both, True)
        measured = self.state.implausible_state
        arguments = self.state.implausible_force, measured, True, 1.0, self._points
        self._protect = entry_point(protect, *both, *arguments)
        self.reset()

    @classmethod
    def from_parameters(
        cls, section: dict[str, Any], axes: tuple[str, ...], timebase: Timebase
    ) -> "ProtectedForce":
        """Make it from the reference force's section of an experiment.

        Raises
        ------
        InputError
            See `ReferenceForce.from_parameters`.
        """
        fastest = largest_force_rate(group(section, "limits"))
        return cls(
            ReferenceForce.from_parameters(section, axes, timebase),
            PlausibleForce(section["limits.force"], fastest, axes, timebase.dt),
            InstabilityWatch.from_parameters(section, axes, timebase),
            RampDown.lasting(section["ramp_down_time"], timebase.dt, section["loop_delay"]),
            section["loop_delay"],
        )

    @cached_property
    def kind(self) -> Hashable:
        """`kind_of` the arguments of a compiled loop: its own, and its compensation method's."""
        of: Any = self.reference_force.compensator
        return kind_of((self.parameters, self.state, of.parameters, of.state))

    @property
    def cause(self) -> str | None:
        """The first fault of this test; latched until `reset`."""
        code = self.state.flags[CAUSE]
        if code == NOTHING:
            return None
        method = self.reference_force.compensator
        if has_computed_model(method) and method.failure:
            return method.failure
        if code == IMPLAUSIBLE_FORCE:
            return self._plausible.describe(self.state.implausible_force)
        if code == IMPLAUSIBLE_STATE:
            return not_finite(self.state.implausible_state, self._plausible.axes)
        assert code == INSTABILITY
        return self._watch.describe()

    def reset(self) -> None:
        """Begin a new test."""
        self.reference_force.reset()
        clear(self.state)
        self.state.progress[:] = 1.0
        self._last_state: Floats | None = None
        if self._settled is not None:
            none = np.zeros((1, 1, self._axes))
            self._settled.extend([none] * (self._settled.maxlen or 0))

    def step(self, ground_motion: Floats | None, state: Floats) -> Floats:
        """Compute the points of one step, as `ReferenceForce.step` does.

        In the ramp the ground motion may be missing: then a target assumes none, and any other
        force is held and scaled down.
        """
        self._last_state = state
        points = self._answer(ground_motion, state)
        if self._settled is None:
            return points
        self._settled.append(points)
        return np.concatenate(self._settled)

    def ask_model(self) -> None:
        """Step a computed model, whose force is used from the next answer on."""
        method = self.reference_force.compensator
        if has_computed_model(method):
            method.ask_model()

    def bridge(self, ground_motion: Sequence[Floats | None], state: Floats) -> None:
        """Interpolate the lost states of steps before this one linearly.

        Parameters
        ----------
        ground_motion : sequence of ndarray or None
            Argument of `step` for each of them.
        state : ndarray
            The state that arrived after them, shape (4, n).
        """
        last = state if self._last_state is None else self._last_state
        for index, motion in enumerate(ground_motion, 1):
            part = index / (len(ground_motion) + 1)
            self.step(motion, (1.0 - part) * last + part * state)

    def _answer(self, ground_motion: Floats | None, state: Floats) -> Floats:
        both, is_known = (self.parameters, self.state), ground_motion is not None
        progress = self._begin_step(*both, is_known)
        motion = (
            np.zeros((1 + self.preview, self._axes)) if ground_motion is None else ground_motion
        )
        if not self.state.flags[HOLDING]:
            self._points[:] = self.reference_force.step(motion, state, progress)
        ground, state = (np.ascontiguousarray(each, np.float64) for each in (motion[0], state))
        self._protect(*both, ground, state, is_known, progress, self._points)
        return self._points.copy()
