"""Signals of a test as rows over the columns of a filter, to write equations of motion with."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from seft_ros.reference_force.compensation.compensator import Knowledge

Floats = npt.NDArray[np.float64]

_ROUNDING = 1e-9  # of a sampling period


def whole_steps(time: float, dt: float) -> int:
    """Fewest whole steps that cover a time, at least one."""
    return max(1, math.ceil(time / dt - _ROUNDING))


def between_samples(steps: float, count: int) -> Floats:
    """Weights of ``count`` samples for the value ``steps`` after the first: linear interpolation.

    Returns
    -------
    ndarray
        Shape (count,); beyond the last sample they give that one.
    """
    weights: Floats = np.maximum(0.0, 1.0 - np.abs(np.arange(count) - min(steps, count - 1.0)))
    return weights


@dataclass(frozen=True)
class Signals:
    """Each signal as a matrix of n rows over the columns (s, y, g) of `LinearFilter.matrix`.

    What is added and multiplied by matrices with these is a gain matrix in the end.

    Attributes
    ----------
    knowledge : Knowledge
        The test.
    preview : int
        Coming steps of the ground motion among the columns.
    blocks : int
        Blocks of n states among them.
    """

    knowledge: Knowledge
    preview: int
    blocks: int = 0

    def state(self, block: int) -> Floats:
        """Block of states, shape (n, columns)."""
        return self._rows(block)

    @property
    def displacement(self) -> Floats:
        """Measured displacement x, shape (n, columns)."""
        return self._rows(self.blocks)

    @property
    def velocity(self) -> Floats:
        """Measured velocity v, shape (n, columns)."""
        return self._rows(self.blocks + 1)

    @property
    def acceleration(self) -> Floats:
        """Measured acceleration a, shape (n, columns)."""
        return self._rows(self.blocks + 2)

    @property
    def restoring_force(self) -> Floats:
        """Measured restoring force r = f - M_e a, shape (n, columns)."""
        return self._rows(self.blocks + 3) - self.knowledge.mass @ self.acceleration

    def ground_motion(self, time: float) -> Floats:
        """Ground acceleration ``time`` seconds from now, shape (n, columns)."""
        n = self.knowledge.axes
        weights = between_samples(time / self.knowledge.dt, 1 + self.preview)
        return np.hstack([np.zeros((n, (self.blocks + 4) * n)), np.kron(weights, np.eye(n))])

    def _rows(self, block: int) -> Floats:
        n = self.knowledge.axes
        return np.eye(n, (self.blocks + 5 + self.preview) * n, k=block * n)
