"""Reference forces that answer the state of their own step, each waited for."""

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import WireError
from seft_msgs_py.topics import REFERENCE_FORCE

Floats = npt.NDArray[np.float64]

PENDING = 256  # steps kept while their other half has not come


class MatchedForces:
    """Reference forces by step, for a loop without a delay of its own."""

    def __init__(self) -> None:
        self._forces: dict[int, Floats] = {}

    @property
    def pending(self) -> int:
        """Number of forces whose states have not come."""
        return len(self._forces)

    def reset(self, in_lockstep: bool = False) -> None:
        """Begin a new test; in lockstep, too, each force is waited for."""
        del in_lockstep
        self._forces.clear()

    def take(self, step: int, points: Floats) -> None:
        """Take a message: the force of its step is the first of its points, shape (p, n), N.

        Raises
        ------
        WireError
            If it has come before.
        """
        if step in self._forces:
            raise WireError(f"{REFERENCE_FORCE.name} of step {step} a second time")
        self._forces[step] = points[0]
        if len(self._forces) > PENDING:
            self._forces.pop(min(self._forces))

    def force(self, step: int) -> Floats | None:
        """Force of a step, shape (n,), N; None if it is to be waited for."""
        force = self._forces.get(step)
        if force is not None:
            for passed in [other for other in self._forces if other <= step]:
                del self._forces[passed]
        return force
