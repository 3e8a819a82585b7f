"""Kinds of springs that a specimen may have, and their parameters."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from seft_msgs_py.config.parameter_table import Parameter, group
from seft_msgs_py.config.registered import Registered
from seft_msgs_py.errors import InputError

from seft_plant_sim.specimen.restoring_force import HystereticSpring, Spring
from seft_plant_sim.specimen.spring_laws import BOUC_WEN, DUFFING, GAP, SLIDER

OWN = ("linear", "bilinear", "bouc_wen", "pinching", "flag", "friction", "gap", "duffing")
KINDS = Registered("seft.restoring_force", OWN)
"""Of other packages: a kind -> what makes a `HystereticSpring`.

It is given elastic stiffness in N/m, yield displacement in m, and hardening ratio, and may take
settings.
"""
_BOUC_WEN = ("exponent", "beta", "gamma", "amplitude_loss", "strength_loss", "stiffness_loss")

PARAMETERS = (
    Parameter(
        "specimen.kind",
        "string",
        "linear",
        "restoring force: linear, bilinear with kinematic hardening, Bouc-Wen, Bouc-Wen that "
        "pinches, flag-shaped (self-centring), Coulomb friction beside the spring, a second "
        "spring beyond a gap, or Duffing's cubic spring",
        choices=KINDS.names,
    ),
    KINDS.settings_row("specimen.settings", "a restoring force"),
    Parameter(
        "specimen.yield_displacement",
        "floats",
        0.0,
        "deformation at which a spring yields, for all or per spring",
        "m",
        minimum=0.0,
    ),
    Parameter(
        "specimen.hardening_ratio",
        "floats",
        0.05,
        "stiffness after yielding over the elastic one, likewise",
        minimum=0.0,
        maximum=0.999,
    ),
    Parameter("specimen.bouc_wen.exponent", "float", 1.0, "sharpness of yielding, n", minimum=1.0),
    Parameter("specimen.bouc_wen.beta", "float", 0.5, "shape of unloading, beta"),
    Parameter("specimen.bouc_wen.gamma", "float", 0.5, "shape of unloading, gamma"),
    *(
        Parameter(
            f"specimen.bouc_wen.{name}_loss",
            "float",
            0.0,
            f"degradation of {name} per work of yield force times yield displacement "
            f"(Baber & Wen 1981, {symbol})",
            minimum=0.0,
        )
        for name, symbol in (
            ("amplitude", "delta_A"),
            ("strength", "delta_nu"),
            ("stiffness", "delta_eta"),
        )
    ),
    Parameter(
        "specimen.pinching.slip",
        "float",
        1.0,
        "half of the slip at each passage through zero force once it has grown, over the yield "
        "displacement; the rest is as of bouc_wen",
        minimum=0.0,
    ),
    Parameter(
        "specimen.pinching.growth",
        "float",
        0.1,
        "growth of the slip per work of yield force times yield displacement",
        positive=True,
    ),
    Parameter(
        "specimen.pinching.width",
        "float",
        0.15,
        "force within which it slips, over the yield force",
        positive=True,
    ),
    Parameter(
        "specimen.flag.dissipation",
        "floats",
        0.5,
        "height of the flag over the yield force, for all or per spring; 0: it dissipates nothing",
        minimum=0.0,
        maximum=1.0,
    ),
    Parameter(
        "specimen.friction.force",
        "floats",
        0.0,
        "friction beside each spring, for all or per spring",
        "N",
        minimum=0.0,
    ),
    Parameter(
        "specimen.friction.presliding",
        "float",
        2e-5,
        "displacement by which it gives way before it slides",
        "m",
        positive=True,
    ),
    Parameter(
        "specimen.gap.width",
        "floats",
        0.0,
        "deformation either way at which the second spring engages, for all or per spring",
        "m",
        minimum=0.0,
    ),
    Parameter(
        "specimen.gap.stiffness",
        "floats",
        0.0,
        "stiffness of the second spring, likewise",
        "N/m",
        minimum=0.0,
    ),
    Parameter(
        "specimen.duffing.cubic",
        "floats",
        0.0,
        "coefficient of the deformation's cube, likewise; below 0 the spring softens, up to its "
        "largest force",
        "N/m^3",
    ),
)


def make_springs(
    kind: str, section: dict[str, Any], stiffness: Sequence[float], where: str
) -> tuple[Spring, ...]:
    """Make the springs of a specimen.

    Parameters
    ----------
    kind : str
        One of `KINDS`, not linear.
    section : dict
        The parameters ``specimen.*``.
    stiffness : sequence of float
        Elastic stiffness of each, N/m.
    where : str
        Names the parameters.

    Raises
    ------
    InputError
        If values make no such spring, or do not fit the springs.
    """

    def each(name: str, need: str = "") -> list[float]:
        numbers = np.atleast_1d(np.asarray(section[name], dtype=np.float64))
        count = len(stiffness)
        if numbers.size not in (1, count):
            raise InputError(
                f"{where}.{name}: {numbers.size} values for {count} springs; give 1 or {count}"
            )
        if need and numbers.min() <= 0.0:
            raise InputError(f"{where}.{name} is {section[name]}, but a {kind} specimen {need}")
        return np.broadcast_to(numbers, count).tolist()

    if kind == "friction":
        presliding = section["friction.presliding"]
        forces = each("friction.force", "has friction: give the force in N")
        return tuple(
            Spring.of_law(SLIDER, k, k, force / presliding, presliding, -presliding)
            for k, force in zip(stiffness, forces, strict=True)
        )
    if kind == "gap":
        second = each("gap.stiffness", "has a second spring: give its stiffness in N/m")
        rows = zip(stiffness, second, each("gap.width"), strict=True)
        return tuple(Spring.of_law(GAP, k, k, k_2, width) for k, k_2, width in rows)
    if kind == "duffing":
        of_cubes = zip(stiffness, each("duffing.cubic"), strict=True)
        return tuple(Spring.of_law(DUFFING, k, k, k_3, _peak(k, k_3)) for k, k_3 in of_cubes)
    yields = each("yield_displacement", "yields: give the displacement in m")
    values = zip(stiffness, yields, each("hardening_ratio"), strict=True)
    if kind in KINDS:
        return tuple(Spring.of(_registered(kind, section, where, *row)) for row in values)
    parts = [(k, a * k, (1.0 - a) * k, z_y) for k, z_y, a in values]
    if kind == "bilinear":
        return tuple(Spring.of_law(SLIDER, *row, -row[3]) for row in parts)
    if kind == "flag":
        heights = each("flag.dissipation")
        flags = zip(parts, heights, strict=True)
        return tuple(Spring.of_law(SLIDER, *row, (1.0 - b) * row[3]) for row, b in flags)
    shape = group(section, "bouc_wen")
    total = shape["beta"] + shape["gamma"]
    if total <= 0.0:
        raise InputError(
            f"{where}.bouc_wen: beta {shape['beta']} and gamma {shape['gamma']} must add up "
            "to more than 0, or the spring never yields"
        )
    reach = total ** (-1.0 / shape["exponent"])  # z / z_y at which the spring as new yields on
    law = [shape[name] for name in _BOUC_WEN]
    slip, growth, width = (
        section[f"pinching.{name}"] if kind == "pinching" else 0.0
        for name in ("slip", "growth", "width")
    )
    return tuple(
        Spring.of_law(BOUC_WEN, *row, reach * row[3], *law, slip, growth, width * row[3])
        for row in parts
    )


def _peak(stiffness: float, cubic: float) -> float:
    """Deformation at which a softening Duffing spring carries most, m: k + 3 k_3 e^2 = 0."""
    return math.sqrt(-stiffness / (3.0 * cubic)) if cubic < 0.0 else math.inf


def _registered(kind: str, section: dict[str, Any], where: str, *values: float) -> HystereticSpring:
    made = KINDS.make(kind, section.get("settings", ""), f"{where}.kind", *values)
    if not isinstance(made, HystereticSpring):
        raise InputError(
            f"{where}.kind is {kind}, but it makes a {type(made).__name__}; it must be "
            "a seft_plant_sim.specimen.restoring_force.HystereticSpring"
        )
    return made
