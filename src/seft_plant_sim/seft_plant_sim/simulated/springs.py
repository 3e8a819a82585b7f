"""Springs of a specimen: the kinds of spring, laws of other packages; the laws compiled.

A law takes a spring along a straight path from one deformation to the next and gives its force.
A spring's memory is a row of three numbers: the deformation e, its hysteretic displacement z, and
the energy that it has dissipated (for `BOUC_WEN` and `CALLED` the work on its hysteretic part, in
units of k z_y^2). All laws are independent of the rate of loading: they do not contain time.

A spring's law is a row of `WIDTH` numbers: which law, the stiffness k of the elastic model, and
the numbers of the law. With k_0, k_1 and z_y of the row::

    SLIDER    s = k_0 e + k_1 z,  z follows e between bounds that depend on e
    BOUC_WEN  s = k_0 e + k_1 z,  z' = e' phi(z) / (1 + f(z) phi(z))
    GAP       s = k_0 e + k_1 (e - z_y) beyond the gap z_y, in both directions
    DUFFING   s = k_0 e + k_1 e^3, constant beyond its peak at z_y, if it has one
    CALLED    a C function of the place of the three numbers, and of e
    ONE_SIDED s = k_1 (e - e_0) beyond e_0, on one side; e_0 and the side (1, -1; 0: it is not
              there) are the second and third number of its memory

docs/rig.md has their sources.
"""

import ctypes
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
from llvmlite import ir
from numba.extending import intrinsic
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.parameter_table import group
from seft_msgs_py.errors import InputError

from seft_plant_sim.compiled import bounded, compiled
from seft_plant_sim.rig_parameters import RESTORING_FORCES

SLIDER, BOUC_WEN, SPRING_GAP, DUFFING, CALLED, ONE_SIDED = range(6)
SPRING_KIND, STIFFNESS, SPRING_BESIDE, HYSTERETIC, Z_Y = range(5)
"""Columns of every law."""
LOWER = ADDRESS = _LIMIT = 5
EXPONENT, BETA, GAMMA, AMPLITUDE_LOSS, STRENGTH_LOSS, STIFFNESS_LOSS = range(6, 12)
SPRING_SLIP, SLIP_RATE, SLIP_WIDTH = range(12, 15)
WIDTH = 15
SPRING_MEMORY = 3
"""Numbers of a spring's memory."""

BOUC_WEN_STEP = 0.03  # of z_y: longest step of `BOUC_WEN` along a path..
STEP_TIMES_EXPONENT = 0.4  # ..and shorter if it yields sharply
_MAX_STEPS = 20_000  # of one path: a longer jump has longer steps


@compiled
def spring_force(laws: Floats, j: int, memory: Floats, e: float) -> float:
    """Take spring j of p straight to a deformation e, m; give its force there, N.

    Laws have shape (p, `WIDTH`); the springs' memory, shape (p, 3), is updated.
    """
    kind = int(laws[j, SPRING_KIND])
    if kind == CALLED:
        return _call(int(laws[j, ADDRESS]), memory.ctypes.data + 8 * SPRING_MEMORY * j, e)
    change = e - memory[j, 0]
    memory[j, 0] = e
    z_y = laws[j, Z_Y]
    if kind == SPRING_GAP:
        beyond = max(abs(e) - z_y, 0.0)
        return laws[j, SPRING_BESIDE] * e + laws[j, HYSTERETIC] * math.copysign(beyond, e)
    if kind == ONE_SIDED:
        side = memory[j, 2]
        return laws[j, HYSTERETIC] * side * max(side * (e - memory[j, 1]), 0.0)
    if kind == DUFFING:
        held = bounded(e, z_y)
        return (laws[j, SPRING_BESIDE] + laws[j, HYSTERETIC] * held * held) * held
    if kind == SLIDER:
        # z = min(max(z + e - e_last, low(e)), high(e)): exact, as the bounds rise no faster than e
        trial, lower = memory[j, 1] + change, laws[j, LOWER]
        high, low = min(max(e, -lower), z_y), max(min(e, lower), -z_y)
        memory[j, 1] = min(max(trial, low), high)
        slip = (trial if change > 0.0 else -trial) - z_y
        if lower >= 0.0:
            slip = min(slip, abs(e) - z_y)
        if slip > 0.0:
            memory[j, 2] += laws[j, HYSTERETIC] * (z_y - max(lower, 0.0)) * slip
    elif change:
        _follow_bouc_wen(laws, j, memory, change)
    return laws[j, SPRING_BESIDE] * e + laws[j, HYSTERETIC] * memory[j, 1]


@compiled
def spring_energies(laws: Floats, j: int, memory: Floats) -> tuple[float, float]:
    """Give a spring's recoverable energy and the energy that it has dissipated, J."""
    kind = int(laws[j, SPRING_KIND])
    e, z, dissipated = memory[j, 0], memory[j, 1], memory[j, 2]
    k_0, k_1, z_y = laws[j, SPRING_BESIDE], laws[j, HYSTERETIC], laws[j, Z_Y]
    if kind == SPRING_GAP:
        return 0.5 * k_0 * e * e + 0.5 * k_1 * max(abs(e) - z_y, 0.0) ** 2, 0.0
    if kind == DUFFING:
        held = min(abs(e), z_y)
        stored = 0.5 * k_0 * held**2 + 0.25 * k_1 * held**4
        if abs(e) > z_y:
            stored += (k_0 + k_1 * z_y**2) * z_y * (abs(e) - z_y)
        return stored, 0.0
    hysteretic = 0.5 * z * z
    if kind == SLIDER:
        hysteretic += max(laws[j, LOWER], 0.0) * (abs(e) - abs(z))
    else:
        if kind == BOUC_WEN and laws[j, SPRING_SLIP]:
            slip, width = _slip(laws, j, dissipated), laws[j, SLIP_WIDTH]
            # integral of f(z) z dz
            hysteretic += slip * width * (1.0 - math.exp(-0.5 * (z / width) ** 2))
        dissipated = laws[j, STIFFNESS] * z_y * z_y * dissipated - k_1 * hysteretic
    return 0.5 * k_0 * e * e + k_1 * hysteretic, dissipated


@compiled
def _follow(law: Floats, memory: Floats, path: Floats, found: Floats) -> None:
    """Take a spring along N deformations, straight between them, see `Spring.follow`."""
    for i in range(len(path)):
        found[0, i] = spring_force(law, 0, memory, path[i])
        found[1, i], found[2, i] = spring_energies(law, 0, memory)


@compiled
def _slip(laws: Floats, j: int, work: float) -> float:
    """Give s sqrt(2 / pi), m: the slip grows with the work (Foliente 1995)."""
    grown = 1.0 - math.exp(-laws[j, SLIP_RATE] * max(work, 0.0))
    return math.sqrt(2.0 / math.pi) * laws[j, SPRING_SLIP] * laws[j, Z_Y] * grown


@compiled
def _bouc_wen_slope(laws: Floats, j: int, sign: float, z: float, work: float) -> float:
    """Slope dz/de of the law of Baber & Wen (1981), with the slip of Baber & Noori (1985)."""
    amplitude = max(0.0, 1.0 - laws[j, AMPLITUDE_LOSS] * work)
    strength = 1.0 + laws[j, STRENGTH_LOSS] * work
    stiffness = 1.0 + laws[j, STIFFNESS_LOSS] * work
    power = abs(z / laws[j, Z_Y])
    if laws[j, EXPONENT] != 1.0:
        power = power ** laws[j, EXPONENT]
    shape = laws[j, GAMMA] + (laws[j, BETA] if z * sign >= 0.0 else -laws[j, BETA])
    # phi = (A - nu (beta sgn(z e') + gamma) |z / z_y|^n) / eta
    slope = amplitude - strength * power * shape
    if stiffness != 1.0:  # a division takes as long as all before it
        slope /= stiffness
    if laws[j, SPRING_SLIP]:
        # e' = e_1' + f(z) z', z' = phi(z) e_1', f = sqrt(2 / pi) s / w exp(-(z / w)^2 / 2)
        width = laws[j, SLIP_WIDTH]
        slip = _slip(laws, j, work) / width * math.exp(-0.5 * (z / width) ** 2)
        slope /= 1.0 + slip * slope
    return slope


@compiled
def _follow_bouc_wen(laws: Floats, j: int, memory: Floats, change: float) -> None:
    """Integrate z and the work along a path (Runge-Kutta, fourth order)."""
    z_y, limit = laws[j, Z_Y], laws[j, _LIMIT]
    longest = min(BOUC_WEN_STEP, STEP_TIMES_EXPONENT / laws[j, EXPONENT]) * z_y
    if laws[j, SPRING_SLIP]:
        longest = min(longest, 0.25 * laws[j, SLIP_WIDTH])
    steps = 1 + int(min(abs(change) / longest, _MAX_STEPS))
    h, sign = change / steps, math.copysign(1.0, change)
    z, work = memory[j, 1], memory[j, 2]
    per_z = laws[j, HYSTERETIC] / (laws[j, STIFFNESS] * z_y * z_y)  # of k z_y^2, per z and e
    for _ in range(steps):
        z1, w1 = _bouc_wen_slope(laws, j, sign, z, work), per_z * z
        y = bounded(z + 0.5 * h * z1, limit)
        z2, w2 = _bouc_wen_slope(laws, j, sign, y, work + 0.5 * h * w1), per_z * y
        y = bounded(z + 0.5 * h * z2, limit)
        z3, w3 = _bouc_wen_slope(laws, j, sign, y, work + 0.5 * h * w2), per_z * y
        y = bounded(z + h * z3, limit)
        z4, w4 = _bouc_wen_slope(laws, j, sign, y, work + h * w3), per_z * y
        z = bounded(z + h / 6.0 * (z1 + 2.0 * z2 + 2.0 * z3 + z4), limit)
        work += h / 6.0 * (w1 + 2.0 * w2 + 2.0 * w3 + w4)
    memory[j, 1], memory[j, 2] = z, work


def _called(context: Any, address: Any, place: Any, e: Any) -> Any:
    """Call the C function at an address: double (int64 place, double e)."""
    del context, address, place, e
    signature = numba.float64(numba.int64, numba.int64, numba.float64)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        del context, signature
        function = ir.FunctionType(ir.DoubleType(), [ir.IntType(64), ir.DoubleType()])
        called = builder.inttoptr(arguments[0], function.as_pointer())
        return builder.call(called, arguments[1:])

    return signature, generate


_call: Any = intrinsic(_called)


PATH_STEP = 0.02  # of the yield displacement: longest step of a law along a path
_Memory = ctypes.c_double * SPRING_MEMORY
_Law = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_int64, ctypes.c_double)


@dataclass(frozen=True)
class Spring:
    """One spring.

    Attributes
    ----------
    law : tuple of float
        Row of `WIDTH` numbers, see above.
    own : _Called, optional
        The law of another package to which the row refers.
    """

    law: tuple[float, ...]
    own: "_Called | None" = field(default=None, compare=False)

    @classmethod
    def of_law(cls, kind: int, stiffness: float, *numbers: float) -> "Spring":
        """Make it from a kind, the elastic stiffness in N/m, and the columns that follow."""
        row = (float(kind), stiffness, *numbers)
        return cls(row + (0.0,) * (WIDTH - len(row)))

    @classmethod
    def of(cls, own: "HystereticSpring") -> "Spring":
        """Make it from a law of another package."""
        called, a = _Called(own), own.hardening_ratio
        parts = (a * own.stiffness, (1.0 - a) * own.stiffness, own.yield_displacement)
        made = cls.of_law(CALLED, own.stiffness, *parts, float(called.address))
        return cls(made.law, called)

    @classmethod
    def elastic(cls, stiffness: float) -> "Spring":
        """Make a linear spring of a stiffness in N/m."""
        return cls.of_law(SPRING_GAP, stiffness, stiffness, 0.0, math.inf)

    @classmethod
    def stop(cls, stiffness: float) -> "Spring":
        """Make a stop of a stiffness in N/m, which is nowhere yet."""
        return cls.of_law(ONE_SIDED, 0.0, 0.0, stiffness)

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
        _follow(np.array([self.law]), np.zeros((1, SPRING_MEMORY)), points, found)
        self.check()
        return found

    def check(self) -> None:
        """Raise the exception of a law of another package, if there was one."""
        if self.own is not None and self.own.raised is not None:
            raise self.own.raised


@dataclass(frozen=True)
class HystereticSpring(ABC):
    """A user's law of hysteresis.

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
        """Return z to its admissible range, after a step of an integrator."""
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
        steps = 1 + int(min(wanted, _MAX_STEPS))
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
        Of the function, valid for the life of this object.
    raised : BaseException or None
        First exception of the law: it can't pass through compiled code, which receives NaN.
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
    """Make the springs of a nonlinear specimen, from elastic stiffnesses in N/m.

    Raises
    ------
    InputError
        If values do not make such a spring, or their number is wrong.
    """
    k = np.array(stiffness)

    def each(name: str, need: str = "") -> Floats:
        numbers = np.atleast_1d(np.asarray(section[name], dtype=np.float64))
        if numbers.size not in (1, k.size):
            mend = f"{k.size} springs; give 1 or {k.size}"
            raise InputError(f"{where}.{name}: {numbers.size} values for {mend}")
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
        return springs(SPRING_GAP, k, second, each("gap.width"))
    if kind == "duffing":
        cubic = each("duffing.cubic")
        # deformation at the largest force of a softening spring: k + 3 k_3 e^2 = 0
        with np.errstate(divide="ignore", invalid="ignore"):
            peak = np.where(cubic < 0.0, np.sqrt(-k / (3.0 * cubic)), np.inf)
        return springs(DUFFING, k, cubic, peak)
    z_y = each("yield_displacement", "yields: give the displacement in m")
    a = each("hardening_ratio")
    if kind in RESTORING_FORCES:
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
    made = RESTORING_FORCES.make(kind, section.get("settings", ""), f"{where}.kind", *values)
    if not isinstance(made, HystereticSpring):
        mend = "it must be a seft_plant_sim.simulated.springs.HystereticSpring"
        raise InputError(f"{where}.kind is {kind}, but it makes a {type(made).__name__}; {mend}")
    return made
