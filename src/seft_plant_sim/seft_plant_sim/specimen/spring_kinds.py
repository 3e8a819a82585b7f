"""Kinds of springs that a specimen may have, and their parameters."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from seft_msgs_py.config.arrays import Floats
from seft_msgs_py.config.parameter_table import Parameter, group, parameter_rows
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
    *parameter_rows(
        """
        yield_displacement      | floats | 0.0  | m     | 0 ..       |
            deformation at which a spring yields, for all or per spring
        hardening_ratio         | floats | 0.05 |       | 0 .. 0.999 |
            stiffness after yielding over the elastic one, likewise
        bouc_wen.exponent       | float  | 1.0  |       | 1 ..       | sharpness of yielding, n
        bouc_wen.beta           | float  | 0.5  |       |            | shape of unloading, beta
        bouc_wen.gamma          | float  | 0.5  |       |            | shape of unloading, gamma
        bouc_wen.amplitude_loss | float  | 0.0  |       | 0 ..       |
            degradation of amplitude per work of yield force times yield displacement
            (Baber & Wen 1981, delta_A)
        bouc_wen.strength_loss  | float  | 0.0  |       | 0 ..       |
            degradation of strength per work of yield force times yield displacement
            (Baber & Wen 1981, delta_nu)
        bouc_wen.stiffness_loss | float  | 0.0  |       | 0 ..       |
            degradation of stiffness per work of yield force times yield displacement
            (Baber & Wen 1981, delta_eta)
        pinching.slip           | float  | 1.0  |       | 0 ..       |
            half of the slip at each passage through zero force once it has grown, over
            the yield displacement; the rest is as of bouc_wen
        pinching.growth         | float  | 0.1  |       | > 0        |
            growth of the slip per work of yield force times yield displacement
        pinching.width          | float  | 0.15 |       | > 0        |
            force within which it slips, over the yield force
        flag.dissipation        | floats | 0.5  |       | 0 .. 1     |
            height of the flag over the yield force, for all or per spring; 0: it
            dissipates nothing
        friction.force          | floats | 0.0  | N     | 0 ..       |
            friction beside each spring, for all or per spring
        friction.presliding     | float  | 2e-5 | m     | > 0        |
            displacement by which it gives way before it slides
        gap.width               | floats | 0.0  | m     | 0 ..       |
            deformation either way at which the second spring engages, for all or per
            spring
        gap.stiffness           | floats | 0.0  | N/m   | 0 ..       |
            stiffness of the second spring, likewise
        duffing.cubic           | floats | 0.0  | N/m^3 |            |
            coefficient of the deformation's cube, likewise; below 0 the spring softens,
            up to its largest force
        """,
        "specimen",
    ),
)


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
            "a seft_plant_sim.specimen.restoring_force.HystereticSpring"
        )
    return made
