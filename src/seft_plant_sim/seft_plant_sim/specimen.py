"""The load-resisting member under test."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.arrays import mass_matrix, symmetric_matrix

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class LinearSpecimen:
    """Mass, damping and stiffness of a linear specimen: M a + C v + K x = f (Eq. 2.4).

    Attributes
    ----------
    mass, damping, stiffness : ndarray
        Shape (n, n), in kg, N s/m and N/m.
    """

    mass: Floats
    damping: Floats
    stiffness: Floats

    @classmethod
    def from_parameters(
        cls, group: dict[str, Any], axes: Sequence[str], where: str
    ) -> "LinearSpecimen":
        """Make it of parameters ``mass``, ``damping`` and ``stiffness``.

        Raises
        ------
        InputError
            If a matrix does not fit the axes, is not symmetric, or mass is not positive.
        """
        return cls(
            mass=mass_matrix(group["mass"], axes, f"{where}.mass"),
            damping=symmetric_matrix(group["damping"], axes, f"{where}.damping"),
            stiffness=symmetric_matrix(group["stiffness"], axes, f"{where}.stiffness"),
        )

    @property
    def axes(self) -> int:
        """Number of axes n."""
        return len(self.mass)

    def state_matrices(self) -> tuple[Floats, Floats]:
        """State-space form over (x, v), driven by the force f.

        Returns
        -------
        a, b : ndarray
            Shapes (2n, 2n) and (2n, n): d/dt (x, v) = a (x, v) + b f.
        """
        n = self.axes
        a = np.zeros((2 * n, 2 * n))
        a[:n, n:] = np.eye(n)
        a[n:, :n] = -np.linalg.solve(self.mass, self.stiffness)
        a[n:, n:] = -np.linalg.solve(self.mass, self.damping)
        b = np.zeros((2 * n, n))
        b[n:] = np.linalg.inv(self.mass)
        return a, b
