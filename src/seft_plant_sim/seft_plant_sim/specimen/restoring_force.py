"""Springs of a specimen: ours by their compiled laws, and those of other packages."""

import ctypes
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from seft_plant_sim.specimen import spring_laws
from seft_plant_sim.specimen.spring_laws import MEMORY, MOST_STEPS, STIFFNESS, WIDTH

Floats = npt.NDArray[np.float64]

PATH_STEP = 0.02  # of the yield displacement: longest step of a law along a path
_Memory = ctypes.c_double * MEMORY
_Law = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_int64, ctypes.c_double)


@dataclass(frozen=True)
class Spring:
    """One spring.

    Attributes
    ----------
    law : tuple of float
        Row of `seft_plant_sim.specimen.spring_laws`.
    own : _Called, optional
        What the row refers to, of a law of another package.
    """

    law: tuple[float, ...]
    own: "_Called | None" = field(default=None, compare=False)

    @classmethod
    def of_law(cls, kind: int, stiffness: float, *numbers: float) -> "Spring":
        """Make it of a kind, the elastic stiffness in N/m, and the columns that follow."""
        row = (float(kind), stiffness, *numbers)
        return cls(row + (0.0,) * (WIDTH - len(row)))

    @classmethod
    def of(cls, own: "HystereticSpring") -> "Spring":
        """Make it of a law of another package."""
        called, a = _Called(own), own.hardening_ratio
        parts = (a * own.stiffness, (1.0 - a) * own.stiffness, own.yield_displacement)
        made = cls.of_law(spring_laws.CALLED, own.stiffness, *parts, float(called.address))
        return cls(made.law, called)

    @property
    def stiffness(self) -> float:
        """Elastic stiffness, N/m."""
        return self.law[STIFFNESS]

    def follow(self, path: npt.ArrayLike) -> Floats:
        """Follow a path of deformations, not loaded before it, straight between its points.

        Parameters
        ----------
        path : array_like
            Shape (N,), m.

        Returns
        -------
        ndarray
            Force (N), stored and dissipated energy (J) at each point, shape (3, N).
        """
        points = np.array(path, dtype=np.float64)
        found = np.empty((3, len(points)))
        spring_laws.follow(np.array([self.law]), np.zeros((1, MEMORY)), points, found)
        self.check()
        return found

    def check(self) -> None:
        """Raise what a law of another package has raised, if it has."""
        if self.own is not None and self.own.raised is not None:
            raise self.own.raised


@dataclass(frozen=True)
class HystereticSpring(ABC):
    """A law of hysteresis of one's own.

    The spring carries s = a k e + (1 - a) k z, where e is its deformation and z its hysteretic
    displacement, which follows e as long as the spring is elastic. The law must be independent of
    the rate of loading.

    Attributes
    ----------
    stiffness : float
        k, elastic, N/m.
    yield_displacement : float
        z_y, m; the yield force is k z_y.
    hardening_ratio : float
        a, stiffness after yielding over k; at least 0 and below 1.
    """

    stiffness: float
    yield_displacement: float
    hardening_ratio: float

    @abstractmethod
    def rate(self, z: float, velocity: float, work: float) -> float:
        """Rate of the hysteretic displacement, m/s.

        Parameters
        ----------
        z : float
            Hysteretic displacement, m.
        velocity : float
            Rate of deformation, m/s.
        work : float
            Work done on the hysteretic part so far, in units of k z_y^2, see `work_rate`.
        """

    def settle(self, z: float) -> float:
        """Bring z back to where the law allows it to be, after a step of an integrator."""
        return z

    def force(self, deformation: float, z: float) -> float:
        """Force, N, at a deformation and a hysteretic displacement, both in m."""
        a = self.hardening_ratio
        return self.stiffness * (a * deformation + (1.0 - a) * self.settle(z))

    def work_rate(self, z: float, velocity: float) -> float:
        """Rate of the work on the hysteretic part, 1/s: (1 - a) z v / z_y^2 (Baber & Wen 1981)."""
        return (1.0 - self.hardening_ratio) * z * velocity / self.yield_displacement**2

    def advance(self, z: float, work: float, change: float) -> tuple[float, float]:
        """Hysteretic displacement and work after a change of deformation (Runge-Kutta)."""
        wanted = abs(change) / (PATH_STEP * self.yield_displacement)
        steps = 1 + int(min(wanted, MOST_STEPS))
        h, sign = change / steps, math.copysign(1.0, change)

        def slopes(z: float, work: float) -> tuple[float, float]:
            return sign * self.rate(z, sign, work), sign * self.work_rate(z, sign)

        for _ in range(steps):
            z1, w1 = slopes(z, work)
            z2, w2 = slopes(z + 0.5 * h * z1, work + 0.5 * h * w1)
            z3, w3 = slopes(z + 0.5 * h * z2, work + 0.5 * h * w2)
            z4, w4 = slopes(z + h * z3, work + h * w3)
            z = self.settle(z + h / 6.0 * (z1 + 2.0 * z2 + 2.0 * z3 + z4))
            work += h / 6.0 * (w1 + 2.0 * w2 + 2.0 * w3 + w4)
        return z, work


class _Called:
    """A law of another package as a C function, which compiled code calls.

    Attributes
    ----------
    address : int
        Of the function; it is there as long as this object is.
    raised : BaseException or None
        What the law raised first: it can't go through compiled code, which gets NaN.
    """

    def __init__(self, law: HystereticSpring) -> None:
        self._law = law
        self._function: Callable[[int, float], float] = _Law(self._force)
        self.address = ctypes.cast(self._function, ctypes.c_void_p).value or 0
        self.raised: BaseException | None = None

    def _force(self, place: int, e: float) -> float:
        memory = _Memory.from_address(place)
        try:
            change, memory[0] = e - memory[0], e
            if change:
                memory[1], memory[2] = self._law.advance(memory[1], memory[2], change)
            return float(self._law.force(e, memory[1]))
        except BaseException as error:
            self.raised = self.raised or error
            return math.nan
