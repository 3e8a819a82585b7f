"""What all compensation methods have in common, and the signals that their equations use."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, TypeGuard

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.errors import InputError
from seft_plant_sim.computed_substructure import ComputedSubstructure

from seft_ros.reference_force.linear_filter import LinearFilter


@dataclass(frozen=True)
class Knowledge:
    """What a method knows, or assumes, of the test over n axes.

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

    A method that computes the motion of a target returns 1 + ``preview`` points of it, see
    `ReferenceForce.step`, and has an attribute ``pace``: 1 in a test; as it goes to 0, the ground
    motion fades and the target comes to rest.

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
        """Linear filter that the method is now: exactly, or as long as no estimate changes."""


def tells_motion(compensator: Compensator) -> bool:
    """Whether a method returns points of a target's motion, and has a pace."""
    return hasattr(compensator, "pace")


class AskingCompensator(Compensator, Protocol):
    """A method whose structure may have a computed model, which is stepped beside its answers.

    Attributes
    ----------
    model : ModelLine or None
        The computed model; None where there is none.
    failure : str
        Why the model failed in this test, one line; empty while it has not.
    """

    model: Any
    failure: str

    def ask_model(self) -> None:
        """Step the model, which is part of no answer but the next."""


def asks_model(compensator: Compensator) -> TypeGuard[AskingCompensator]:
    """Whether a method may have a computed model."""
    return hasattr(compensator, "ask_model")


Method = Callable[[Knowledge], Compensator]


class NotLinearError(InputError):
    """What another package has registered has no ``linear()``: only a simulation judges it."""

    def __init__(self, where: str, name: str) -> None:
        super().__init__(
            f"{where}: {name} has no linear(), so the margins of its stability are not known"
        )


class RegisteredPart:
    """Another package's method or controller, of which only ``step`` is required.

    Parameters
    ----------
    where, name : str
        Parameter that names it, and its name as registered.
    make : callable
        Makes it. One without ``reset()`` is made anew for each test.
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
        """Give what its own ``linear()`` gives; a `NotLinearError` says that it has none."""
        if not hasattr(self._own, "linear"):
            raise NotLinearError(self._where, self._name)
        return self._own.linear()

    def _check_shape(self, what: str, unit: str, found: Any, axes: int) -> None:
        """Check the first result of ``step``; InputError if it is not one value for each axis."""
        if np.shape(found) != (axes,):
            raise InputError(
                f"{self._where}: the {what} of {self._name} has the shape {np.shape(found)}, but "
                f"must have {(axes,)}: one value in {unit} for each axis"
            )


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
