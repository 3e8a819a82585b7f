"""The one shape of all compensation methods, and what they are made of."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from seft_plant_sim.reference.computed_substructure import ComputedSubstructure

from seft_ros.reference_force.compensation.linear_filter import LinearFilter

Floats = npt.NDArray[np.float64]


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
