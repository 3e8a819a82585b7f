"""Reference forces that answer the state of their own step, each waited for."""

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.topics import REFERENCE_FORCE

Floats = npt.NDArray[np.float64]

PENDING = 256  # steps kept while their other half has not come


class MatchedForces:
    """Reference forces by step, for a loop without a delay of its own."""

    def __init__(self) -> None:
        self._points: dict[int, Floats] = {}

    @property
    def pending(self) -> int:
        """Number of forces whose states have not come."""
        return len(self._points)

    def reset(self, in_lockstep: bool = False) -> None:
        """Begin a new test; in lockstep, too, each force is waited for."""
        del in_lockstep
        self._points.clear()

    def take(self, step: int, points: Floats) -> None:
        """Take a message: the points of its step and coming ones, shape (p, q, n).

        Raises
        ------
        WireError
            If it has come before.
        """
        if step in self._points:
            raise WireError(f"{REFERENCE_FORCE.name} of step {step} a second time")
        self._points[step] = points
        if len(self._points) > PENDING:
            self._points.pop(min(self._points))

    def points(self, step: int) -> Floats | None:
        """Points of a step and coming ones; None if they are to be waited for."""
        points = self._points.get(step)
        if points is not None:
            for passed in [other for other in self._points if other <= step]:
                del self._points[passed]
        return points
