"""The interface of all compensation methods, and the signals that their equations use."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple, Protocol, TypeGuard, runtime_checkable

import numpy as np
from seft_msgs_py.arrays import Floats, clear, zeros
from seft_msgs_py.config.facts import FORCE_DRIVEN
from seft_msgs_py.errors import InputError
from seft_plant_sim.compiled import compiled, copy, entry_point, multiply
from seft_plant_sim.computed.computed_substructure import ComputedSubstructure


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


OF_THE_LOOP = 1.5
"""Sampling periods from a force to its first effect at a sample, and half of a held one."""


@dataclass(frozen=True)
class MethodInputs:
    """The known or assumed data of a test over n axes, for a compensation method.

    Attributes
    ----------
    mass : ndarray
        M_e on the rig, shape (n, n), kg.
    computed : ComputedSubstructure
        The computed substructure; none of its masses couples axes and internal degrees of freedom.
        In an EFT test it is empty.
    damping, stiffness : ndarray
        Assumed C and K of the specimen, shape (n, n), N s/m, N/m.
    dt : float
        Sampling period, s.
    options : mapping
        Section of the reference force in the experiment.
    late : float
        Delay of a link, and of the sensors where nothing feeds the force back, s.
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
    late: float = 0.0
    loop_delay: int = 0
    springs: Floats | None = None

    @property
    def axes(self) -> int:
        """Number of axes n."""
        return len(self.mass)

    @property
    def computed_mass(self) -> Floats:
        """M_c, computed on the axes, shape (n, n), kg: sufficient for most methods."""
        return self.computed.mass[: self.axes, : self.axes]

    @property
    def total_mass(self) -> Floats:
        """M_e + M_c, shape (n, n), kg."""
        return self.mass + self.computed_mass

    @property
    def share(self) -> Floats:
        """S = M_c (M_e + M_c)^-1, shape (n, n)."""
        return self.computed_mass @ np.linalg.inv(self.total_mass)

    @property
    def assumed_delay(self) -> float:
        """Delay from reference force to measured force, that of the loop included, s."""
        return float(self.options["actuator.delay"]) + OF_THE_LOOP * self.dt + self.late

    @property
    def delay(self) -> float:
        """Delay to compensate, that of the loop included, s; InputError if it is not known."""
        own, whole = self.options["actuator.delay"], self.assumed_delay
        if min(own, whole) <= 0 and self.options["actuator.kind"] not in FORCE_DRIVEN:
            method = f"reference_force: compensation.method {self.options['compensation.method']}"
            text = f"{method} needs the delay from reference force to measured force"
            how = "seft identify finds it and writes it into model.yaml, to be read by"
            raise InputError(f"/**: actuator.delay is 0, but {text}; {how} --params-file")
        return whole


@runtime_checkable
class Compensator(Protocol):
    """The interface of a compensation method.

    A method that computes the motion of a target returns 1 + ``preview`` points of it, see
    `ReferenceForce.step`, and has an attribute ``progress``: 1 in a test; while it falls to 0, the
    ground motion fades and the target slows down to rest.

    Attributes
    ----------
    preview : int
        Number of later steps whose ground motion it needs.
    """

    preview: int

    def reset(self) -> None:
        """Forget the test so far."""

    def step(self, ground_motion: Floats, state: Floats) -> Floats:
        """Compute the reference force of one step.

        Parameters
        ----------
        ground_motion : ndarray
            Ground acceleration of each axis, of this step and the later ones, shape
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
        """Linear filter of the method: exact, or for its present estimates."""


def provides_target(compensator: Compensator) -> bool:
    """Whether a method returns points of a target's motion, and has a progress."""
    return hasattr(compensator, "progress")


def has_computed_model(compensator: Compensator) -> TypeGuard[Any]:
    """Whether a method's structure may have a computed model, which is stepped after its answers.

    Then it has the attributes ``model``, a `ModelLine` or None, and ``failure``: the reason of the
    model's failure in this test, one line; empty without a failure. Its ``ask_model()`` steps the
    model, whose force is used from the next answer on.
    """
    return hasattr(compensator, "ask_model")


Method = Callable[[MethodInputs], Compensator]


class NotLinearError(InputError):
    """A part of another package has no ``linear()``: only a simulation shows its stability."""

    def __init__(self, where: str, name: str) -> None:
        text = "has no linear(), so the margins of its stability are not known"
        super().__init__(f"{where}: {name} {text}")


class RegisteredPart:
    """Another package's method or controller; only its ``step`` is required.

    Parameters
    ----------
    where, name : str
        Parameter that names it, and its name as registered.
    make : callable
        Makes it. Without ``reset()`` it is made again for each test.
    takes : str
        Arguments of ``step``.

    Raises
    ------
    InputError
        If it has no ``step``.
    """

    def __init__(self, where: str, name: str, make: Callable[[], Any], takes: str) -> None:
        self._where, self._name, self._make, self._own = where, name, make, make()
        if not callable(getattr(self._own, "step", None)):
            raise InputError(f"{where}: {name} has no step({takes}); docs/tutorial.md shows one")

    def reset(self) -> None:
        """Begin a new test."""
        if hasattr(self._own, "reset"):
            self._own.reset()
        else:
            self._own = self._make()

    def linear(self) -> Any:
        """Give the result of its own ``linear()``; NotLinearError if it has none."""
        if not hasattr(self._own, "linear"):
            raise NotLinearError(self._where, self._name)
        return self._own.linear()

    def _check_shape(self, what: str, unit: str, found: Any, axes: int) -> None:
        """Check the first result of ``step``; InputError if it is not one value for each axis."""
        if np.shape(found) != (axes,):
            wanted = f"must have {(axes,)}: one value in {unit} for each axis"
            shape = f"the {what} of {self._name} has the shape {np.shape(found)}"
            raise InputError(f"{self._where}: {shape}, but {wanted}")


class RegisteredCompensator(RegisteredPart):
    """Completes another package's method over n axes, see `RegisteredPart`."""

    def __init__(self, name: str, make: Callable[[], Any], axes: int) -> None:
        where = "reference_force: compensation.method"
        super().__init__(where, name, make, "ground_motion, state")
        self.preview = int(getattr(self._own, "preview", 0))
        first = self.step(np.zeros((1 + self.preview, axes)), np.zeros((4, axes)))
        self._check_shape("force", "N", first, axes)
        self.reset()

    def step(self, ground_motion: Floats, state: Floats) -> Floats:
        """See `Compensator.step`."""
        return np.asarray(self._own.step(ground_motion, state), dtype=np.float64)

    def estimates(self) -> dict[str, Floats]:
        """See `Compensator.estimates`."""
        return self._own.estimates() if hasattr(self._own, "estimates") else {}
