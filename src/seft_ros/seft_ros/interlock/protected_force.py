"""The reference force with its own layer of the interlock: guards, plausibility, ramp."""

from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.timebase import Timebase

from seft_ros.interlock.guard import Guard
from seft_ros.interlock.instability import InstabilityWatch
from seft_ros.interlock.plausibility import PlausibleForce, PlausibleState
from seft_ros.interlock.ramp_down import RampDown
from seft_ros.reference_force.block import ReferenceForce

Floats = npt.NDArray[np.float64]


class ProtectedForce:
    """A `ReferenceForce` that is looked at in each step, and comes down softly if it must.

    While nothing is wrong and nobody asks for the ramp, it gives the very force of the block.
    In the ramp the force goes on following the test, scaled down; a target is slowed down to rest
    instead. A force that is not plausible is never given: from there on the last plausible one
    stands in for it, and the target stands still, scaled down, too.

    In a loop with a delay of d steps, the force that is computed from the state of step k is for
    step k + d, and the points are the forces of the steps k to k + d, which do not change any
    more: what is late or lost is made good by the next. A target tells its coming motion anyway.

    Parameters
    ----------
    reference_force : ReferenceForce
        The block.
    plausible : PlausibleForce
        Limits of its force.
    guards : sequence of Guard
        What else may ask for the ramp, asked in this order in each step until one does.
    ramp : RampDown
        The way to zero.
    loop_delay : int
        d.

    Attributes
    ----------
    preview : int
        Steps of coming ground motion that `step` wants to see.
    learn : callable
        As the block's: to be called when the answer is out.
    cause : str or None
        The first fault of this test; latched until `reset`.
    reference_force, plausible, guards, ramp
        As given.
    """

    def __init__(
        self,
        reference_force: ReferenceForce,
        plausible: PlausibleForce,
        guards: Sequence[Guard],
        ramp: RampDown,
        loop_delay: int = 0,
    ) -> None:
        self.preview = reference_force.preview
        self.estimates, self.learn = reference_force.estimates, reference_force.learn
        self.cause: str | None = None
        self.reference_force = reference_force
        self.plausible, self.guards, self.ramp = plausible, tuple(guards), ramp
        self._settled: deque[Floats] | None = None  # of the last steps
        if loop_delay and not reference_force.tells_motion:
            self._settled = deque(maxlen=1 + loop_delay)
        self.reset()

    @classmethod
    def from_parameters(
        cls, section: dict[str, Any], axes: tuple[str, ...], timebase: Timebase
    ) -> "ProtectedForce":
        """Make it of the reference force's section of an experiment.

        Raises
        ------
        InputError
            As `ReferenceForce.from_parameters`.
        """
        return cls(
            ReferenceForce.from_parameters(section, axes, timebase),
            PlausibleForce(
                section["limits.force"], section["limits.force_rate"], axes, timebase.dt
            ),
            [PlausibleState(axes), InstabilityWatch.from_parameters(section, axes, timebase)],
            RampDown.lasting(section["ramp_down_time"], timebase.dt, section["loop_delay"]),
            section["loop_delay"],
        )

    @property
    def ramping(self) -> bool:
        """Whether the ramp has begun."""
        return self.ramp.begun

    @property
    def steps_ramped(self) -> int:
        """Steps since the ramp began, the one in which it did included."""
        return self.ramp.taken

    @property
    def at_rest(self) -> bool:
        """Whether the force that is applied has come down to zero, and stays there."""
        return self.ramp.finished

    def reset(self) -> None:
        """Begin a new test."""
        self.cause = None
        self._holding = False
        self.reference_force.reset()
        self.plausible.reset()
        axes = len(self.plausible.last)
        self._last = np.zeros((*self.reference_force.shape, axes))
        self._last_factor = 1.0
        self._state: Floats | None = None
        if self._settled is not None:
            self._settled.extend([np.zeros((1, 1, axes))] * (self._settled.maxlen or 0))
        self.ramp.reset()
        for guard in self.guards:
            guard.reset()

    def ramp_down(self) -> None:
        """Bring the force down from the next step on."""
        self.ramp.begin()

    def step(self, ground_motion: Floats | None, state: Floats) -> Floats:
        """Compute the points of one step, as `ReferenceForce.step` does.

        Without ground motion, which may be missing in the ramp, a target takes it to be none, and
        any other force is held while it is scaled down.
        """
        self._state = state
        points = self._answer(ground_motion, state)
        if self._settled is None:
            return points
        self._settled.append(points)
        return np.concatenate(self._settled)

    def bridge(self, ground_motion: Sequence[Floats | None], state: Floats) -> None:
        """Make good for the states of steps that were lost before this one, in a straight line.

        Parameters
        ----------
        ground_motion : sequence of ndarray or None
            What `step` would have been given for each of them.
        state : ndarray
            That has come after them, shape (4, n).
        """
        last = state if self._state is None else self._state
        for index, motion in enumerate(ground_motion, 1):
            part = index / (len(ground_motion) + 1)
            self.step(motion, (1.0 - part) * last + part * state)

    def _answer(self, ground_motion: Floats | None, state: Floats) -> Floats:
        block, points, motion, fault = self.reference_force, self._last, ground_motion, None
        pace = factor = self.ramp.next()
        if motion is None:
            self._holding |= not block.tells_motion
            motion = np.zeros((1 + self.preview, state.shape[1]))
        if not self._holding:
            points = block.step(motion, state, pace)
            fault = self.plausible.fault(points[0, -1])
            self._holding = fault is not None
        if self.cause is None:
            self.cause = fault
            if fault is None and ground_motion is not None:
                self.cause = self._asked_for(motion[0], state)
            if self.cause is not None and not self.ramp.begun:
                self.ramp.begin()
                factor = self.ramp.next()
        if self._holding:
            return self._held(factor)
        self._last = points
        if block.tells_motion:
            self._last_factor = pace
            return points
        return points * factor if self.ramp.begun else points

    def _held(self, factor: float) -> Floats:
        """Last plausible point, standing still and scaled down from there."""
        points = np.repeat(self._last[:1], len(self._last), axis=0)
        points[:, 1:-1] = 0.0  # the velocity of a target
        return points * (factor / self._last_factor if self._last_factor else 0.0)

    def _asked_for(self, ground_motion: Floats, state: Floats) -> str | None:
        for guard in self.guards:
            if (cause := guard.step(ground_motion, state)) is not None:
                return cause
        return None
