"""Linear filter whose output gains may change while it runs."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from seft_ros.reference_force.compensation.linear_filter import LinearFilter

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Memory:
    """What a filter of n axes remembers, whatever its output gains are.

    ::

        f_r[k] = gains (s[k], y[k], g[k...])
        s[k+1] = a s[k] + b y[k] + h g[k] + w f_r[k]

    The states s mean the same at all gains, and so remain right while these change.

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
        """Nothing is remembered."""
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
        """Linear filter that it is with gains of shape (n, s + 4n + (1 + preview) n)."""
        size, measured = self.b.shape
        c, d, e = np.split(gains, [size, size + measured], axis=1)
        w, h = self.w, self.w @ e
        h[:, : self.h.shape[1]] += self.h
        return LinearFilter(self.a + w @ c, self.b + w @ d, h, c, d, e)


class VaryingFilter:
    """A `Memory` at work, with gains that may be set between two steps.

    Parameters
    ----------
    memory : Memory
        What it remembers.
    gains : ndarray
        First gains, shape (n, s + 4n + (1 + preview) n).

    Attributes
    ----------
    gains : ndarray
        Present gains, of the same shape.
    preview : int
        Steps of coming ground motion that it looks at.
    """

    def __init__(self, memory: Memory, gains: Floats) -> None:
        self.gains = gains
        n, size = len(gains), len(memory.a)
        self._update = np.ascontiguousarray(np.hstack([memory.a, memory.b, memory.h]))
        self._inputs = memory.w.copy() if memory.w.any() else None
        self._work = np.zeros(gains.shape[1])
        self._states = self._work[:size]
        self._measured = self._work[size : size + 4 * n].reshape(4, n)
        self._remembered = self._work[: size + 5 * n]
        self._ground_motion = self._work[size + 4 * n :].reshape(-1, n)
        self.preview = len(self._ground_motion) - 1

    def reset(self) -> None:
        """Forget the test so far."""
        self._work[:] = 0.0

    def step(self, ground_motion: Floats, state: Floats) -> Floats:
        """Compute the reference force of one step, see `Compensator.step`."""
        self._measured[:] = state
        self._ground_motion[:] = ground_motion
        force: Floats = self.gains.dot(self._work)
        if len(self._states):
            states = self._update.dot(self._remembered)
            if self._inputs is not None:
                states += self._inputs.dot(force)
            self._states[:] = states
        return force
