"""The reference force with its own layer of the interlock: guards, plausibility, ramp."""

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
    In the ramp the force goes on following the test, scaled down. A force that is not plausible
    is never given: from there on the last plausible one stands in for it.

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
    ) -> None:
        self.preview = reference_force.preview
        self.estimates, self.learn = reference_force.estimates, reference_force.learn
        self.cause: str | None = None
        self.reference_force = reference_force
        self.plausible, self.guards, self.ramp = plausible, tuple(guards), ramp
        self._holding = False

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
        self.ramp.reset()
        for guard in self.guards:
            guard.reset()

    def ramp_down(self) -> None:
        """Bring the force down from the next step on."""
        self.ramp.begin()

    def step(self, ground_motion: Floats, state: Floats) -> Floats:
        """Compute the reference force of one step, as `ReferenceForce.step` does."""
        force = self.reference_force.step(ground_motion, state)
        fault = None if self._holding else self.plausible.fault(force)
        if fault is not None:
            self._holding = True
        if self.cause is None:
            self.cause = fault or self._asked_for(ground_motion[0], state)
            if self.cause is not None:
                self.ramp.begin()
        return self._scaled() if self.ramp.begun else force

    def step_without_motion(self) -> Floats:
        """Force of a step of the ramp whose ground motion is missing: the last, scaled down."""
        self._holding = True
        return self._scaled()

    def coming(self, changes: Floats) -> Floats:
        """Tell the forces to be expected after the last one: within its limits, and in its ramp.

        Parameters
        ----------
        changes : ndarray
            What is expected of coming steps beside the last force, shape (p, n), N.

        Returns
        -------
        ndarray
            Shape (p, n), N.
        """
        last = np.array(self.plausible.last)
        if self._holding:
            changes = np.zeros_like(changes)
        factors = np.array(self.ramp.coming(len(changes)))
        return self.plausible.held(last + changes) * factors[:, np.newaxis]

    def _asked_for(self, ground_motion: Floats, state: Floats) -> str | None:
        for guard in self.guards:
            if (cause := guard.step(ground_motion, state)) is not None:
                return cause
        return None

    def _scaled(self) -> Floats:
        return np.array(self.plausible.last) * self.ramp.next()
