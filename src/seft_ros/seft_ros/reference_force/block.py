"""Reference force: what the actuators are asked to apply."""

from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.arrays import mass_matrix, symmetric_matrix
from seft_msgs_py.parameters import group

from seft_ros.reference_force.compensation import METHODS, Compensator

Floats = npt.NDArray[np.float64]


class ReferenceForce:
    """Reference force of a test over n axes.

    - ``eft``:  f_r = -(M_e + M_c) a_g                  (paper Eq. 2.3)
    - ``seft``: f_r = -(M_e + M_c) a_g - M_c a          (paper Eq. 2.5)

    with M_c = mass_ratio M_e and the acceleration a as measured or compensated.

    Parameters
    ----------
    method : str
        ``eft`` or ``seft``.
    mass : ndarray
        M_e, shape (n, n), kg.
    mass_ratio : float
        alpha.
    compensator : Compensator
        Source of the acceleration that is fed back.
    """

    def __init__(
        self, method: str, mass: Floats, mass_ratio: float, compensator: Compensator
    ) -> None:
        axes = len(mass)
        computed = mass_ratio * mass if method == "seft" else np.zeros_like(mass)
        self._inertia = np.hstack([-(1.0 + mass_ratio) * mass, -computed])
        self._work = np.zeros(2 * axes)
        self._ground_motion, self._acceleration = self._work[:axes], self._work[axes:]
        self._compensator = compensator

    @classmethod
    def from_parameters(cls, section: dict[str, Any], axes: tuple[str, ...]) -> "ReferenceForce":
        """Make it of its section of an experiment.

        Raises
        ------
        InputError
            If the model's sizes do not fit the axes, or its mass is not positive.
        """
        where = "reference_force: model"
        mass = mass_matrix(section["model.mass"], axes, f"{where}.mass")
        for name in ("damping", "stiffness"):
            symmetric_matrix(section[f"model.{name}"], axes, f"{where}.{name}")
        compensation = group(section, "compensation")
        compensator = METHODS[compensation["method"]](compensation)
        return cls(section["method"], mass, section["mass_ratio"], compensator)

    def reset(self) -> None:
        """Forget the test so far."""
        self._compensator.reset()

    def step(self, ground_motion: Floats, state: Floats) -> Floats:
        """Compute the reference force of one step.

        Parameters
        ----------
        ground_motion : ndarray
            Ground acceleration of each axis at the step, shape (n,), m/s^2.
        state : ndarray
            Measured displacement, velocity, acceleration and force, shape (4, n).

        Returns
        -------
        ndarray
            Shape (n,), N.
        """
        self._ground_motion[:] = ground_motion
        self._acceleration[:] = self._compensator.acceleration(state)
        return self._inertia.dot(self._work)
