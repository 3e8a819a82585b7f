"""What blocked pistons cost a force controller that inverts the specimen."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from seft_ros.identification.blocked_error import blocked_error
from seft_ros.identification.plant_fit import PlantFit
from seft_ros.identification.specimen_fit import SpecimenFit
from seft_ros.loop_shaping.controller import Controller

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

_COMPARED_HZ = np.linspace(2.0, 15.0, 50)


@dataclass(frozen=True)
class BlockedCompliance:
    """Error over force of a loop with blocked pistons, over what the specimen resists with.

    With u = g Z^-1 (f_r - f), Z = M s^2 + C s + K, a blocked piston's force is f = H u, and the
    error E f = Z (g H)^-1 f. What remains of E without Z is a polynomial for all axes over the
    size of each.

    Attributes
    ----------
    polynomial : tuple of float
        In s, highest power first, m/N; good up to about 20 Hz.
    sizes : tuple of float
        Gain of each axis's H over that of the first.
    """

    polynomial: tuple[float, ...]
    sizes: tuple[float, ...]

    @classmethod
    def of(cls, fits: Sequence[PlantFit], gain: float, dt: float) -> "BlockedCompliance":
        """Make it of each axis's valve-to-force response and the controller's gain g (V/m)."""
        controller = Controller.from_coefficients(gain, 1.0)
        each = np.array([blocked_error(fit, controller, dt) for fit in fits])
        s = 2j * np.pi * _COMPARED_HZ
        seen = np.abs([np.polyval(polynomial, s) for polynomial in each])
        sizes = np.exp(np.log(seen[0] / seen).mean(axis=1))
        mean = (each * sizes[:, np.newaxis]).mean(axis=0)
        return cls(tuple(mean.tolist()), tuple(sizes.tolist()))

    def error(self, specimen: SpecimenFit, hz: Floats) -> Complexes:
        """Give E with a specimen at frequencies, shape (N, n, n)."""
        s = 2j * np.pi * hz[:, np.newaxis, np.newaxis]
        resists = specimen.mass * s**2 + specimen.damping * s + specimen.stiffness
        found: Complexes = np.polyval(self.polynomial, s) * resists / np.array(self.sizes)
        return found
