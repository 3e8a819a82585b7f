"""A force controller of another package, kept within the valve's range."""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from seft_ros.force_controller.force_control import ControlKnowledge
from seft_ros.reference_force.compensator import RegisteredPart

Floats = npt.NDArray[np.float64]


class RegisteredControl(RegisteredPart):
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
        What it knows of the test.

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
        super().__init__("force_controller: method", name, make, "reference_force, state")
        self._limit, n = knowledge.voltage_limit, knowledge.axes
        self._check_shape("drive", "V", self._own.step(np.zeros(n), np.zeros((4, n))), n)
        self.reset()

    def reset(self) -> None:
        """See `ForceControl.reset`."""
        super().reset()
        self.limited = False

    def step(self, points: Floats, state: Floats) -> Floats:
        """See `ForceControl.step`."""
        wanted: Floats = self._own.step(points[0, -1], state)
        drive = np.clip(wanted, -self._limit, self._limit)
        self.limited = bool((np.abs(drive) >= self._limit).any())
        if self.limited and hasattr(self._own, "limited"):
            self._own.limited(drive)
        return drive
