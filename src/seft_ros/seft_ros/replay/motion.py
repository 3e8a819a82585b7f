"""Ground motion of a recorded test, in one piece."""

from collections.abc import Sequence

import numpy as np
from seft_msgs_py.wire.trajectory import Floats

from seft_ros.reference_force.motion_buffer import MotionBuffer


class Motion:
    """Ground accelerations by step, from the messages that told them.

    Parameters
    ----------
    chunks : sequence of (int, ndarray)
        First step and accelerations of each message, shape (p, n), m/s^2, in their order.
    axes : int
        n.

    Attributes
    ----------
    steps : int
        Steps that are known without a gap, from 0 on.
    pieces : list of (int, ndarray)
        They as they came, without what came twice.
    """

    def __init__(self, chunks: Sequence[tuple[int, Floats]], axes: int) -> None:
        self.pieces: list[tuple[int, Floats]] = []
        self.steps = 0
        for first, values in chunks:
            if first <= self.steps < first + len(values):
                self.pieces.append((self.steps, values[self.steps - first :]))
                self.steps = first + len(values)
        self._buffer = MotionBuffer(axes)
        if self.pieces:
            self._buffer.add(0, np.concatenate([values for _, values in self.pieces]))

    def window(self, step: int, count: int) -> Floats | None:
        """Accelerations of ``count`` steps from ``step`` on, shape (count, n), if all are there."""
        return self._buffer.window(step, count)
