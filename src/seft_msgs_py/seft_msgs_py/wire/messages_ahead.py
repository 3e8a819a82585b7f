"""Messages that tell of coming steps, for who uses them some steps later."""

from collections import deque

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


class MessagesAhead:
    """Points of messages, of which each step takes those of the message d steps before it.

    So it does not matter when a message came, as long as it came in time. Where that message is
    missing, the next counts, and where there is none, the last.

    Parameters
    ----------
    loop_delay : int
        d.
    nothing : ndarray
        Points before the first message, as of step -1.
    """

    def __init__(self, loop_delay: int, nothing: Floats) -> None:
        self._loop_delay = loop_delay
        self._messages = deque([(-1, nothing)])

    def add(self, step: int, points: Floats) -> None:
        """Add the message of a step, newer than those before: points of it and coming steps."""
        self._messages.append((step, points))

    def of(self, step: int) -> tuple[int, Floats]:
        """Find the message for a step; steps never go back.

        Returns
        -------
        age : int
            Steps after that of the message.
        points : ndarray
            Of the message.
        """
        while len(self._messages) > 1 and self._messages[0][0] < step - self._loop_delay:
            self._messages.popleft()
        first, points = self._messages[0]
        return step - first, points
