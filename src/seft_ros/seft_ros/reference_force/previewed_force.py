"""The reference force with previews, for a force controller behind a link."""

from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.timebase import Timebase

from seft_ros.interlock.protected_force import ProtectedForce
from seft_ros.reference_force.continuation import Continuation

Floats = npt.NDArray[np.float64]


class PreviewedForce:
    """Forces of this step and the coming ones, of a loop with a delay of d steps.

    The force that is computed from the state of step k is for step k + d; those of the steps
    before were computed from earlier states and do not change any more. So every message that
    comes within the delay says the same of a step: what is late or lost is made good by the
    next. Forces beyond k + d are expected (`Continuation`), for when none has come.

    Parameters
    ----------
    force : ProtectedForce
        Computes the force for step k + d.
    continuation : Continuation
        Tells how it will go on.
    loop_delay : int
        d, at least 1.
    axes : int
        n.

    Attributes
    ----------
    preview : int
        Steps of coming ground motion that `step` wants to see.
    """

    def __init__(
        self, force: ProtectedForce, continuation: Continuation, loop_delay: int, axes: int
    ) -> None:
        self.preview = max(force.preview, continuation.preview)
        self._force, self._continuation = force, continuation
        self._window = 1 + force.preview
        self._none = np.zeros((continuation.steps, axes))
        self._settled: deque[Floats] = deque(maxlen=1 + loop_delay)
        self._axes = axes
        self.reset()

    @classmethod
    def from_parameters(
        cls,
        force: ProtectedForce,
        section: dict[str, Any],
        axes: tuple[str, ...],
        timebase: Timebase,
    ) -> "PreviewedForce":
        """Make it around a force, of the reference force's section of an experiment."""
        continuation = Continuation(section, axes, timebase)
        return cls(force, continuation, section["loop_delay"], len(axes))

    def reset(self) -> None:
        """Begin a new test: no force before the first that is computed."""
        self._settled.extend([np.zeros(self._axes)] * (self._settled.maxlen or 0))
        self._last: Floats | None = None
        self._continuation.reset()

    def step(self, ground_motion: Floats, state: Floats) -> Floats:
        """Compute the forces from the state of one step, both given as to `ReferenceForce.step`.

        Returns
        -------
        ndarray
            Of this step and the coming ones, shape (1 + d + p, n), N.
        """
        self._take(ground_motion, state)
        return self._points(self._continuation.changes())

    def bridge(self, ground_motion: Sequence[Floats | None], state: Floats) -> None:
        """Make good for the states of steps that were lost before this one, in a straight line.

        Parameters
        ----------
        ground_motion : sequence of ndarray or None
            What `step` would have been given for each of them; None in a ramp whose ground motion
            is missing.
        state : ndarray
            That has come after them, shape (4, n).
        """
        last = state if self._last is None else self._last
        for index, motion in enumerate(ground_motion, 1):
            part = index / (len(ground_motion) + 1)
            if motion is None:
                self._settled.append(self._force.step_without_motion())
            else:
                self._take(motion, (1.0 - part) * last + part * state)

    def step_without_motion(self) -> Floats:
        """Compute the forces from a step of the ramp whose ground motion is missing."""
        self._settled.append(self._force.step_without_motion())
        return self._points(self._none)

    def _take(self, ground_motion: Floats, state: Floats) -> None:
        self._last = state
        self._continuation.take(ground_motion, state)
        self._settled.append(self._force.step(ground_motion[: self._window], state))

    def _points(self, changes: Floats) -> Floats:
        return np.vstack([*self._settled, self._force.coming(changes)])
