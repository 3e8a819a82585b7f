"""What all compensation methods have in common, and the linear ones among them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from seft_msgs_py.config.arrays import Floats
from seft_plant_sim.compiled import compiled, entry_point
from seft_plant_sim.computed_substructure import ComputedSubstructure
from seft_plant_sim.integration import multiply


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
        b, h = np.zeros((0, d.shape[1])), np.zeros((0, e.shape[1]))
        return cls(np.zeros((0, 0)), b, h, np.zeros((n, 0)), d, e)

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


class LinearParameters(NamedTuple):
    """What `linear_step` does not change: `LinearFilter.matrix`, transposed."""

    matrix: Floats


class LinearState(NamedTuple):
    """What it does: states and inputs (s, y, g), and what the matrix makes of them (f_r, s)."""

    work: Floats
    result: Floats


@compiled
def linear_step(
    parameters: LinearParameters,
    state: LinearState,
    ground: Floats,
    measured: Floats,
    pace: float,
    points: Floats,
) -> None:
    """Compute the reference force of one step.

    Parameters
    ----------
    parameters, state
        The state is brought up to date.
    ground : ndarray
        Ground acceleration of this step and the coming ones, shape (1 + preview, n), m/s^2.
    measured : ndarray
        Displacement, velocity, acceleration and force, shape (4, n).
    pace : float
        Of no matter here, see `target_step`.
    points : ndarray
        The result, shape (1, 1, n), N.
    """
    work, result, n = state.work, state.result, measured.shape[1]
    place = states = len(result) - n
    for row in range(4):
        for i in range(n):
            work[place] = measured[row, i]
            place += 1
    for row in range(len(ground)):
        for i in range(n):
            work[place] = ground[row, i]
            place += 1
    multiply(parameters.matrix, work, result)
    for i in range(n):
        points[0, 0, i] = result[i]
    for i in range(states):
        work[i] = result[n + i]


class LinearCompensator:
    """A `LinearFilter` as a compensator: one matrix-vector product to a step.

    Parameters
    ----------
    linear_filter : LinearFilter
        The method.

    Attributes
    ----------
    parameters, state : LinearParameters, LinearState
        What `linear_step` takes, here and in a compiled loop.
    """

    def __init__(self, linear_filter: LinearFilter) -> None:
        self.preview, n = linear_filter.preview, linear_filter.axes
        self._filter = linear_filter
        self.parameters = LinearParameters(np.ascontiguousarray(linear_filter.matrix().T))
        self.state = LinearState(*map(np.zeros, self.parameters.matrix.shape))
        self._points, measured = np.zeros((1, 1, n)), np.zeros((4, n))
        arguments = measured, measured, 1.0, self._points
        self._step = entry_point(linear_step, self.parameters, self.state, *arguments)

    def reset(self) -> None:
        """Forget the test so far."""
        self.state.work[:] = 0.0

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


@dataclass(frozen=True)
class Knowledge:
    """What a method is told of the test over n axes.

    Attributes
    ----------
    mass : ndarray
        M_e on the rig, shape (n, n), kg.
    computed : ComputedSubstructure
        What is computed beside it, no mass of which couples axes and internal degrees of freedom.
        In an EFT test it is nothing.
    damping, stiffness : ndarray
        C and K of the specimen as far as the experimenter knows them, shape (n, n), N s/m, N/m.
    dt : float
        Sampling period, s.
    options : mapping
        Parameters ``compensation.*`` and ``tracking.*`` of the reference force, by name; the
        delays and dead times among them hold the loop's delay.
    loop_delay : int
        Steps from a state to the first use of the force that is computed from it.
    springs : ndarray or None
        Deformation of each spring that may yield per displacement of each axis, shape (p, n).
    """

    mass: Floats
    computed: ComputedSubstructure
    damping: Floats
    stiffness: Floats
    dt: float
    options: Mapping[str, Any]
    loop_delay: int = 0
    springs: Floats | None = None

    @property
    def axes(self) -> int:
        """Number of axes n."""
        return len(self.mass)

    @property
    def computed_mass(self) -> Floats:
        """M_c, computed on the axes, shape (n, n), kg: all that most methods need to know."""
        return self.computed.mass[: self.axes, : self.axes]

    @property
    def total_mass(self) -> Floats:
        """M_e + M_c, shape (n, n), kg."""
        return self.mass + self.computed_mass

    @property
    def share(self) -> Floats:
        """S = M_c (M_e + M_c)^-1, shape (n, n)."""
        return self.computed_mass @ np.linalg.inv(self.total_mass)


class Compensator(Protocol):
    """What the reference force asks of a compensation method.

    A method that tells the motion of a target returns points of it, see `ReferenceForce.step`,
    1 + ``preview`` of them, and has ``pace`` beside: 1 in a test; as that goes to 0, the ground
    motion fades and the target comes to rest.

    Attributes
    ----------
    preview : int
        Steps of coming ground motion that it looks at.
    """

    preview: int

    def reset(self) -> None:
        """Forget the test so far."""

    def step(self, ground_motion: Floats, state: Floats) -> Floats:
        """Compute the reference force of one step.

        Parameters
        ----------
        ground_motion : ndarray
            Ground acceleration of each axis, of this step and the coming ones, shape
            (1 + preview, n), m/s^2.
        state : ndarray
            Measured displacement (m), velocity (m/s), acceleration (m/s^2) and force (N),
            shape (4, n).

        Returns
        -------
        ndarray
            Shape (n,), N.
        """

    def estimates(self) -> dict[str, Floats]:
        """Estimate of each quantity that is identified on line, by name; shape (n,) each."""

    def linear(self) -> LinearFilter:
        """Linear filter that the method is now: exactly, or as long as no estimate changes."""


def tells_motion(compensator: Compensator) -> bool:
    """Whether a method returns points of a target's motion, and has a pace."""
    return hasattr(compensator, "pace")


Method = Callable[[Knowledge], Compensator]
