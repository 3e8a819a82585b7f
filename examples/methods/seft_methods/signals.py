"""Equations as rows over the columns of a linear filter, and the filter's states."""

from dataclasses import dataclass

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_ros.reference_force.compensation_methods import between_samples
from seft_ros.reference_force.compensator import LinearFilter, MethodInputs


@dataclass(frozen=True)
class Signals:
    """Each signal as a matrix of n rows over the columns (s, y, g) of `LinearFilter.matrix`.

    Sums of these, multiplied by matrices, are a gain matrix.

    Attributes
    ----------
    inputs : MethodInputs
        The test.
    preview : int
        Future steps of the ground motion among the columns.
    blocks : int
        Blocks of n states among the columns.
    """

    inputs: MethodInputs
    preview: int
    blocks: int = 0

    def state(self, block: int) -> Floats:
        """Block of states, shape (n, columns)."""
        n = self.inputs.axes
        return np.eye(n, (self.blocks + 5 + self.preview) * n, k=block * n)

    @property
    def measured(self) -> list[Floats]:
        """Measured displacement, velocity, acceleration and force, shape (n, columns) each."""
        return [self.state(self.blocks + row) for row in range(4)]

    @property
    def restoring_force(self) -> Floats:
        """Measured restoring force r = f - M_e a, shape (n, columns)."""
        _, _, a, f = self.measured
        return f - self.inputs.mass @ a

    def ground_motion(self, time: float) -> Floats:
        """Ground acceleration ``time`` seconds from now, shape (n, columns)."""
        n = self.inputs.axes
        weights = between_samples(time / self.inputs.dt, 1 + self.preview)
        return np.hstack([np.zeros((n, (self.blocks + 4) * n)), np.kron(weights, np.eye(n))])


@dataclass(frozen=True)
class Memory:
    """States of a filter of n axes, for any output gains.

    ::

        f_r[k] = gains (s[k], y[k], g[k...])
        s[k+1] = a s[k] + b y[k] + h g[k] + w f_r[k]

    The states s have the same meaning at all gains, so that the gains may change.

    Attributes
    ----------
    a, b, h, w : ndarray
        Shapes (s, s), (s, 4n), (s, n) and (s, n).
    """

    a: Floats
    b: Floats
    h: Floats
    w: Floats

    @classmethod
    def none(cls, axes: int) -> "Memory":
        """Make one without states."""
        return cls(*(np.zeros((0, columns)) for columns in (0, 4 * axes, axes, axes)))

    @classmethod
    def past(cls, signal: Floats, blocks: int) -> "Memory":
        """Last values of a signal, the newest first.

        Parameters
        ----------
        signal : ndarray
            The signal of the measured y and the ground acceleration g[k], shape (n, 5n).
        blocks : int
            Number of values.
        """
        n = len(signal)
        size = blocks * n
        newest = np.zeros((size, 5 * n))
        newest[:n] = signal
        b, h = newest[:, : 4 * n], newest[:, 4 * n :]
        return cls(np.eye(size, k=-n), b, h, np.zeros((size, n)))

    def with_gains(self, gains: Floats) -> LinearFilter:
        """Make the linear filter with gains of shape (n, s + 4n + (1 + preview) n)."""
        size, measured = self.b.shape
        c, d, e = np.split(gains, [size, size + measured], axis=1)
        w, h = self.w, self.w @ e
        h[:, : self.h.shape[1]] += self.h
        return LinearFilter(self.a + w @ c, self.b + w @ d, h, c, d, e)
