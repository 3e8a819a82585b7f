"""Springs of a specimen: the kinds of spring, and laws of other packages."""

import ctypes
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.config.arrays import Floats
from seft_msgs_py.config.parameter_table import group
from seft_msgs_py.errors import InputError

from seft_plant_sim import spring_laws
from seft_plant_sim.rig_parameters import KINDS
from seft_plant_sim.spring_laws import (
    BOUC_WEN,
    DUFFING,
    GAP,
    MEMORY,
    MOST_STEPS,
    SLIDER,
    STIFFNESS,
    WIDTH,
)

PATH_STEP = 0.02  # of the yield displacement: longest step of a law along a path
_Memory = ctypes.c_double * MEMORY
_Law = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_int64, ctypes.c_double)


@dataclass(frozen=True)
class Spring:
    """One spring.

    Attributes
    ----------
    law : tuple of float
        Row of `seft_plant_sim.spring_laws`.
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


_BOUC_WEN = ("exponent", "beta", "gamma", "amplitude_loss", "strength_loss", "stiffness_loss")


def make_springs(
    kind: str, section: dict[str, Any], stiffness: Sequence[float], where: str
) -> tuple[Spring, ...]:
    """Make the springs of a specimen that is not linear, of elastic stiffnesses in N/m.

    Raises
    ------
    InputError
        If values make no such spring, or do not fit the springs.
    """
    k = np.array(stiffness)

    def each(name: str, need: str = "") -> Floats:
        numbers = np.atleast_1d(np.asarray(section[name], dtype=np.float64))
        if numbers.size not in (1, k.size):
            raise InputError(
                f"{where}.{name}: {numbers.size} values for {k.size} springs; give 1 or {k.size}"
            )
        if need and numbers.min() <= 0.0:
            raise InputError(f"{where}.{name} is {section[name]}, but a {kind} specimen {need}")
        return np.broadcast_to(numbers, k.size)

    def springs(law: int, *columns: Floats | float) -> tuple[Spring, ...]:
        rows = np.column_stack(np.broadcast_arrays(k, *columns)).tolist()
        return tuple(Spring.of_law(law, *row) for row in rows)

    if kind == "friction":
        presliding = section["friction.presliding"]
        force = each("friction.force", "has friction: give the force in N")
        return springs(SLIDER, k, force / presliding, presliding, -presliding)
    if kind == "gap":
        second = each("gap.stiffness", "has a second spring: give its stiffness in N/m")
        return springs(GAP, k, second, each("gap.width"))
    if kind == "duffing":
        cubic = each("duffing.cubic")
        # deformation at which a softening spring carries most: k + 3 k_3 e^2 = 0
        peak = [
            math.sqrt(-k / (3.0 * c)) if c < 0.0 else math.inf
            for k, c in zip(stiffness, cubic.tolist(), strict=True)
        ]
        return springs(DUFFING, k, cubic, np.array(peak))
    z_y, a = (
        each("yield_displacement", "yields: give the displacement in m"),
        each("hardening_ratio"),
    )
    if kind in KINDS:
        rows = np.column_stack([k, z_y, a]).tolist()
        return tuple(Spring.of(_registered(kind, section, where, *row)) for row in rows)
    parts = a * k, (1.0 - a) * k, z_y
    if kind == "bilinear":
        return springs(SLIDER, *parts, -z_y)
    if kind == "flag":
        return springs(SLIDER, *parts, (1.0 - each("flag.dissipation")) * z_y)
    shape = group(section, "bouc_wen")
    total = shape["beta"] + shape["gamma"]
    if total <= 0.0:
        raise InputError(
            f"{where}.bouc_wen: beta {shape['beta']} and gamma {shape['gamma']} must add up "
            "to more than 0, or the spring never yields"
        )
    limit = total ** (-1.0 / shape["exponent"])  # z / z_y at which the spring as new yields on
    slip, growth, width = (
        section[f"pinching.{name}"] if kind == "pinching" else 0.0
        for name in ("slip", "growth", "width")
    )
    law = [shape[name] for name in _BOUC_WEN]
    return springs(BOUC_WEN, *parts, limit * z_y, *law, slip, growth, width * z_y)


def _registered(kind: str, section: dict[str, Any], where: str, *values: float) -> HystereticSpring:
    made = KINDS.make(kind, section.get("settings", ""), f"{where}.kind", *values)
    if not isinstance(made, HystereticSpring):
        raise InputError(
            f"{where}.kind is {kind}, but it makes a {type(made).__name__}; it must be "
            "a seft_plant_sim.springs.HystereticSpring"
        )
    return made
