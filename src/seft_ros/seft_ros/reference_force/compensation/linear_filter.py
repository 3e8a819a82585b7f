"""Linear compensation: from what is measured and known ahead to the reference force."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class LinearFilter:
    """Linear, time-invariant compensation of n axes, with its states s.

    With the measured y = (x, v, a, f) and the ground accelerations g of this step and the
    `preview` coming ones::

        f_r[k] = c s[k] + d y[k] + e g[k...]
        s[k+1] = a s[k] + b y[k] + h g[k...]

    The reference force itself may be among the states. Preflight takes the eigenvalues of the
    closed loop from these very matrices.

    Attributes
    ----------
    a, b, h : ndarray
        Shapes (s, s), (s, 4n) and (s, (1 + preview) n).
    c, d, e : ndarray
        Shapes (n, s), (n, 4n) and (n, (1 + preview) n).
    """

    a: Floats
    b: Floats
    h: Floats
    c: Floats
    d: Floats
    e: Floats

    @classmethod
    def of_gains(cls, d: Floats, e: Floats) -> "LinearFilter":
        """Filter that remembers nothing."""
        n = len(d)
        return cls(
            a=np.zeros((0, 0)),
            b=np.zeros((0, d.shape[1])),
            h=np.zeros((0, e.shape[1])),
            c=np.zeros((n, 0)),
            d=d,
            e=e,
        )

    @property
    def axes(self) -> int:
        """Number of axes n."""
        return len(self.d)

    @property
    def preview(self) -> int:
        """Steps of coming ground motion that it looks at."""
        return self.e.shape[1] // self.axes - 1

    def delayed(self, steps: int) -> "LinearFilter":
        """Filter whose reference force comes so many steps later."""
        if not steps:
            return self
        n, size, late = self.axes, len(self.a), self.axes * steps
        shift = np.eye(late, k=-n)  # the newest force first
        first = np.eye(late, n)
        return LinearFilter(
            a=np.block([[self.a, np.zeros((size, late))], [first @ self.c, shift]]),
            b=np.vstack([self.b, first @ self.d]),
            h=np.vstack([self.h, first @ self.e]),
            c=np.hstack([np.zeros((n, size)), np.eye(n, late, k=late - n)]),
            d=np.zeros_like(self.d),
            e=np.zeros_like(self.e),
        )

    def matrix(self) -> Floats:
        """Matrix from (s, y, g) to (f_r, s of the next step)."""
        return np.block([[self.c, self.d, self.e], [self.a, self.b, self.h]])


class LinearCompensator:
    """A `LinearFilter` as a compensator: one matrix-vector product to a step.

    Parameters
    ----------
    linear_filter : LinearFilter
        The method.
    """

    def __init__(self, linear_filter: LinearFilter) -> None:
        self.preview = linear_filter.preview
        self._filter = linear_filter
        self._matrix = np.ascontiguousarray(linear_filter.matrix())
        n, size = linear_filter.axes, len(linear_filter.a)
        self._axes = n
        self._work = np.zeros(self._matrix.shape[1])
        self._states = self._work[:size]
        self._measured = self._work[size : size + 4 * n].reshape(4, n)
        self._ground_motion = self._work[size + 4 * n :].reshape(-1, n)

    def reset(self) -> None:
        """Forget the test so far."""
        self._work[:] = 0.0

    def step(self, ground_motion: Floats, state: Floats) -> Floats:
        """Compute the reference force of one step, see `Compensator.step`."""
        self._measured[:] = state
        self._ground_motion[:] = ground_motion
        result = self._matrix.dot(self._work)
        self._states[:] = result[self._axes :]
        return result[: self._axes]

    def estimates(self) -> dict[str, Floats]:
        """Nothing is identified on line."""
        return {}

    def linear(self) -> LinearFilter:
        """Return the filter."""
        return self._filter
