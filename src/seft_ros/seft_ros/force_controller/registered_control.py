"""A force controller of another package, kept within the valve's range."""

from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError

from seft_ros.force_controller.force_control import ControlKnowledge, LinearControl

Floats = npt.NDArray[np.float64]


class RegisteredControl:
    """Cuts off what another package's controller asks for beyond the limit.

    Parameters
    ----------
    own : object
        With ``step(reference_force, state)``, the force of shape (n,), in N, and ``reset()`` as of
        a `ForceControl`; its drive may be beyond the limit. Where it has ``linear()``, preflight
        knows its stability. Where it has ``limited(drive)``, it is told each drive that was cut
        off, so that it does not wind up.
    name : str
        As registered.
    knowledge : ControlKnowledge
        What it was told.

    Attributes
    ----------
    limited, shape
        See `ForceControl`.

    Raises
    ------
    InputError
        If its drive has another shape than one value for each axis.
    """

    shape = 1, 1

    def __init__(self, own: Any, name: str, knowledge: ControlKnowledge) -> None:
        self._own, self._name, self._limit = own, name, knowledge.voltage_limit
        n = knowledge.axes
        shape = np.shape(own.step(np.zeros(n), np.zeros((4, n))))
        if shape != (n,):
            raise InputError(
                f"force_controller: the drive of {name} has the shape {shape}, but must have "
                f"{(n,)}: one value in V for each axis"
            )
        own.reset()
        self._tell = getattr(own, "limited", None)
        self.limited = False

    def reset(self) -> None:
        """See `ForceControl.reset`."""
        self._own.reset()
        self.limited = False

    def step(self, points: Floats, state: Floats) -> Floats:
        """See `ForceControl.step`."""
        wanted: Floats = self._own.step(points[0, -1], state)
        drive = np.clip(wanted, -self._limit, self._limit)
        self.limited = bool((np.abs(drive) >= self._limit).any())
        if self.limited and self._tell is not None:
            self._tell(drive)
        return drive

    def linear(self) -> LinearControl:
        """See `ForceControl.linear`."""
        if not hasattr(self._own, "linear"):
            raise InputError(
                f"force_controller: {self._name} has no linear(), so its stability is not known "
                "before the test; docs/tutorial.md shows one that has"
            )
        found: LinearControl = self._own.linear()
        return found
