"""Linear compensation: from measured signals and known ground motion to the reference force."""

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats, clear, zeros
from seft_plant_sim.compiled import compiled, copy, entry_point, multiply


@dataclass(frozen=True)
class LinearFilter:
    """Linear, time-invariant compensation of n axes, with its states s.

    With the measured y = (x, v, a, f) and the ground accelerations g of this step and the
    `preview` later ones::

        f_r[k] = c s[k] + d y[k] + e g[k...]
        s[k+1] = a s[k] + b y[k] + h g[k...]

    The reference force itself may be among the states. Preflight computes the eigenvalues of the
    closed loop from exactly these matrices.

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
        """Filter without states."""
        n = len(d)
        b, h = np.zeros((0, d.shape[1])), np.zeros((0, e.shape[1]))
        return cls(np.zeros((0, 0)), b, h, np.zeros((n, 0)), d, e)

    @property
    def axes(self) -> int:
        """Number of axes n."""
        return len(self.d)

    @property
    def preview(self) -> int:
        """Number of later steps whose ground motion it needs."""
        return self.e.shape[1] // self.axes - 1

    def delayed(self, steps: int) -> "LinearFilter":
        """Filter whose reference force is delayed by so many steps."""
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


class LinearParameters(NamedTuple):
    """Constants of `linear_step`: `LinearFilter.matrix`, transposed."""

    matrix: Floats


class LinearState(NamedTuple):
    """State: arrays of zeros."""

    work: Annotated[Floats, "inputs"]  # states and inputs (s, y, g)
    result: Annotated[Floats, "outputs"]  # the matrix's product with them (f_r, s)


@compiled
def linear_step(
    parameters: LinearParameters,
    state: LinearState,
    ground: Floats,
    measured: Floats,
    progress: float,
    points: Floats,
) -> None:
    """Compute the reference force of one step.

    Parameters
    ----------
    parameters, state
        The state is updated.
    ground : ndarray
        Ground acceleration of this step and the later ones, shape (1 + preview, n), m/s^2.
    measured : ndarray
        Displacement, velocity, acceleration and force, shape (4, n).
    progress : float
        Not used; see `target_step`.
    points : ndarray
        The result, shape (1, 1, n), N.
    """
    work, result, n = state.work, state.result, measured.shape[1]
    states = len(result) - n
    for row in range(4):
        copy(n, measured[row], work[states + row * n :])
    for row in range(len(ground)):
        copy(n, ground[row], work[states + (4 + row) * n :])
    multiply(parameters.matrix, work, result)
    copy(n, result, points[0, 0])
    copy(states, result[n:], work)


class LinearCompensator:
    """A `LinearFilter` as a compensator: one matrix-vector product for each step.

    Parameters
    ----------
    linear_filter : LinearFilter
        The method.

    Attributes
    ----------
    parameters, state : LinearParameters, LinearState
        Arguments of `linear_step`, here and in a compiled loop.
    """

    def __init__(self, linear_filter: LinearFilter) -> None:
        self.preview, n = linear_filter.preview, linear_filter.axes
        self._filter = linear_filter
        self.parameters = LinearParameters(np.ascontiguousarray(linear_filter.matrix().T))
        inputs, outputs = self.parameters.matrix.shape
        self.state = zeros(LinearState, {"inputs": inputs, "outputs": outputs})
        self._points, measured = np.zeros((1, 1, n)), np.zeros((4, n))
        arguments = measured, measured, 1.0, self._points
        self._step = entry_point(linear_step, self.parameters, self.state, *arguments)

    def reset(self) -> None:
        """Forget the test so far."""
        clear(self.state)

    def step(self, ground_motion: Floats, state: Floats) -> Floats:
        """Compute the reference force of one step, see `Compensator.step`."""
        ground, state = (np.ascontiguousarray(each, np.float64) for each in (ground_motion, state))
        self._step(self.parameters, self.state, ground, state, 1.0, self._points)
        return self._points[0, 0].copy()

    def estimates(self) -> dict[str, Floats]:
        """Nothing is identified on line."""
        return {}

    def linear(self) -> LinearFilter:
        """Return the filter."""
        return self._filter
