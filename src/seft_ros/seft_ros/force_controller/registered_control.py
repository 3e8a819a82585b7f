"""A force controller of another package, kept within the valve's range."""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError

from seft_ros.force_controller.force_control import ControlKnowledge, LinearControl
from seft_ros.reference_force.compensator import NotLinearError

Floats = npt.NDArray[np.float64]


class RegisteredControl:
    """Cuts off what another package's controller asks for beyond the limit.

    Parameters
    ----------
    make : callable
        Makes the controller: an object with ``step(reference_force, state)``, the force of shape
        (n,), in N; its drive may be beyond the limit. One without ``reset()`` is made anew for
        each test. Where it has ``linear()``, preflight knows its margins. Where it has
        ``limited(drive)``, it is called with each drive that was cut off, so that it does not wind
        up.
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

    def __init__(self, make: Callable[[], Any], name: str, knowledge: ControlKnowledge) -> None:
        self._make, self._name, self._limit = make, name, knowledge.voltage_limit
        self._own = own = make()
        n = knowledge.axes
        if not callable(getattr(own, "step", None)):
            raise InputError(
                f"force_controller: method: {name} has no step(reference_force, state); "
                "docs/tutorial.md shows a controller"
            )
        shape = np.shape(own.step(np.zeros(n), np.zeros((4, n))))
        if shape != (n,):
            raise InputError(
                f"force_controller: the drive of {name} has the shape {shape}, but must have "
                f"{(n,)}: one value in V for each axis"
            )
        self.reset()

    def reset(self) -> None:
        """See `ForceControl.reset`."""
        if hasattr(self._own, "reset"):
            self._own.reset()
        else:
            self._own = self._make()
        self.limited = False

    def step(self, points: Floats, state: Floats) -> Floats:
        """See `ForceControl.step`."""
        wanted: Floats = self._own.step(points[0, -1], state)
        drive = np.clip(wanted, -self._limit, self._limit)
        self.limited = bool((np.abs(drive) >= self._limit).any())
        if self.limited and hasattr(self._own, "limited"):
            self._own.limited(drive)
        return drive

    def linear(self) -> LinearControl:
        """See `ForceControl.linear`."""
        if not hasattr(self._own, "linear"):
            raise NotLinearError("force_controller: method", self._name)
        found: LinearControl = self._own.linear()
        return found
