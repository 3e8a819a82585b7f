"""The interface of all compensation methods, and the signals that their equations use."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, TypeGuard, runtime_checkable

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.facts import FORCE_DRIVEN
from seft_msgs_py.errors import InputError
from seft_plant_sim.computed.computed_substructure import ComputedSubstructure

from seft_ros.reference_force.linear_filter import LinearFilter

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
            raise InputError(
                f"/**: actuator.delay is 0, but reference_force: compensation.method "
                f"{self.options['compensation.method']} needs the delay from reference force to "
                "measured force; seft identify finds it and writes it into model.yaml, to be read "
                "by --params-file"
            )
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
        super().__init__(
            f"{where}: {name} has no linear(), so the margins of its stability are not known"
        )


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
