"""Restoring-force laws of springs, compiled.

A law takes a spring along a straight path from one deformation to the next and gives its force.
What it remembers is a row of three numbers: the deformation e, its hysteretic displacement z, and
the energy that it has dissipated (for `BOUC_WEN` and `CALLED` the work on its hysteretic part, in
units of k z_y^2). All laws are independent of the rate of loading: no time occurs in them.

A spring's law is a row of `WIDTH` numbers: which law, the stiffness k that the elastic model has,
and the law's own. With k_0, k_1 and z_y of the row::

    SLIDER    s = k_0 e + k_1 z,  z follows e between bounds that depend on e
    BOUC_WEN  s = k_0 e + k_1 z,  z' = e' phi(z) / (1 + f(z) phi(z))
    GAP       s = k_0 e + k_1 (e - z_y) beyond the gap z_y, either way
    DUFFING   s = k_0 e + k_1 e^3, held beyond its peak at z_y, if it has one
    CALLED    a C function that takes the place of the three numbers, and e

docs/rig.md has their sources.
"""

import math
from typing import Any

import numba
from llvmlite import ir
from numba.extending import intrinsic
from seft_msgs_py.config.arrays import Floats

from seft_plant_sim.compiled import compiled

SLIDER, BOUC_WEN, GAP, DUFFING, CALLED = range(5)
KIND, STIFFNESS, BESIDE, HYSTERETIC, Z_Y = range(5)
"""Columns of every law."""
LOWER = ADDRESS = LIMIT = 5
EXPONENT, BETA, GAMMA, AMPLITUDE_LOSS, STRENGTH_LOSS, STIFFNESS_LOSS = range(6, 12)
SLIP, SLIP_RATE, SLIP_WIDTH = range(12, 15)
WIDTH = 15
MEMORY = 3
"""Numbers that a spring remembers."""

PATH_STEP = 0.03  # of z_y: longest step of `BOUC_WEN` along a path..
STEP_TIMES_EXPONENT = 0.4  # ..and shorter where it yields sharply
MOST_STEPS = 20_000  # of one path: a jump beyond is followed roughly


@compiled
def spring_force(laws: Floats, j: int, memory: Floats, e: float) -> float:
    """Take spring j of p straight to a deformation e, m; give its force there, N.

    Laws have shape (p, `WIDTH`); what the springs remember, shape (p, 3), is brought up to date.
    """
    kind = int(laws[j, KIND])
    if kind == CALLED:
        return _call(int(laws[j, ADDRESS]), memory.ctypes.data + 8 * MEMORY * j, e)
    change = e - memory[j, 0]
    memory[j, 0] = e
    z_y = laws[j, Z_Y]
    if kind == GAP:
        beyond = max(abs(e) - z_y, 0.0)
        return laws[j, BESIDE] * e + laws[j, HYSTERETIC] * math.copysign(beyond, e)
    if kind == DUFFING:
        held = _bounded(e, z_y)
        return (laws[j, BESIDE] + laws[j, HYSTERETIC] * held * held) * held
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
    return laws[j, BESIDE] * e + laws[j, HYSTERETIC] * memory[j, 1]


@compiled
def spring_energies(laws: Floats, j: int, memory: Floats) -> tuple[float, float]:
    """Give a spring's recoverable energy and the energy that it has dissipated, J."""
    kind = int(laws[j, KIND])
    e, z, dissipated = memory[j, 0], memory[j, 1], memory[j, 2]
    k_0, k_1, z_y = laws[j, BESIDE], laws[j, HYSTERETIC], laws[j, Z_Y]
    if kind == GAP:
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
        if kind == BOUC_WEN and laws[j, SLIP]:
            slip, width = _slip(laws, j, dissipated), laws[j, SLIP_WIDTH]
            # integral of f(z) z dz
            hysteretic += slip * width * (1.0 - math.exp(-0.5 * (z / width) ** 2))
        dissipated = laws[j, STIFFNESS] * z_y * z_y * dissipated - k_1 * hysteretic
    return 0.5 * k_0 * e * e + k_1 * hysteretic, dissipated


@compiled
def follow(law: Floats, memory: Floats, path: Floats, found: Floats) -> None:
    """Take a spring along N deformations, straight between them, see `Spring.follow`."""
    for i in range(len(path)):
        found[0, i] = spring_force(law, 0, memory, path[i])
        found[1, i], found[2, i] = spring_energies(law, 0, memory)


@compiled
def _bounded(z: float, limit: float) -> float:
    return min(max(z, -limit), limit)


@compiled
def _slip(laws: Floats, j: int, work: float) -> float:
    """Give s sqrt(2 / pi), m: the slip grows with the work (Foliente 1995)."""
    grown = 1.0 - math.exp(-laws[j, SLIP_RATE] * max(work, 0.0))
    return math.sqrt(2.0 / math.pi) * laws[j, SLIP] * laws[j, Z_Y] * grown


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
    slope = (amplitude - strength * power * shape) / stiffness
    if laws[j, SLIP]:
        # e' = e_1' + f(z) z', z' = phi(z) e_1', f = sqrt(2 / pi) s / w exp(-(z / w)^2 / 2)
        width = laws[j, SLIP_WIDTH]
        slip = _slip(laws, j, work) / width * math.exp(-0.5 * (z / width) ** 2)
        slope /= 1.0 + slip * slope
    return slope


@compiled
def _follow_bouc_wen(laws: Floats, j: int, memory: Floats, change: float) -> None:
    """Integrate z and the work along a path (Runge-Kutta, fourth order)."""
    z_y, limit = laws[j, Z_Y], laws[j, LIMIT]
    longest = min(PATH_STEP, STEP_TIMES_EXPONENT / laws[j, EXPONENT]) * z_y
    if laws[j, SLIP]:
        longest = min(longest, 0.25 * laws[j, SLIP_WIDTH])
    steps = 1 + int(min(abs(change) / longest, MOST_STEPS))
    h, sign = change / steps, math.copysign(1.0, change)
    z, work = memory[j, 1], memory[j, 2]
    per_z = laws[j, HYSTERETIC] / (laws[j, STIFFNESS] * z_y * z_y)  # of k z_y^2, per z and e
    for _ in range(steps):
        z1, w1 = _bouc_wen_slope(laws, j, sign, z, work), per_z * z
        y = _bounded(z + 0.5 * h * z1, limit)
        z2, w2 = _bouc_wen_slope(laws, j, sign, y, work + 0.5 * h * w1), per_z * y
        y = _bounded(z + 0.5 * h * z2, limit)
        z3, w3 = _bouc_wen_slope(laws, j, sign, y, work + 0.5 * h * w2), per_z * y
        y = _bounded(z + h * z3, limit)
        z4, w4 = _bouc_wen_slope(laws, j, sign, y, work + h * w3), per_z * y
        z = _bounded(z + h / 6.0 * (z1 + 2.0 * z2 + 2.0 * z3 + z4), limit)
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
