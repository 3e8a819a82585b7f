"""Rigs that differ from the configured one by what an experimenter does not know exactly."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from seft_msgs_py.config.arrays import per_axis
from seft_msgs_py.config.parameter_table import Section, Value
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.timebase import Timebase
from seft_plant_sim.rig import Rig
from seft_plant_sim.rig_parameters import TABLE

Floats = npt.NDArray[np.float64]

UNCERTAINTY = {
    "specimen.mass": 0.2,  # it is weighed
    "specimen.damping": 5.0,
    "specimen.stiffness": 1.0,
    "specimen.yield_displacement": 1.0,
    "actuator.delay": 1.0,
    "actuator.oil_stiffness": 1.0,
    "actuator.oil_column_frequency": 0.5,  # the root of a stiffness
    "actuator.bulk_modulus": 1.0,
    "actuator.flow_gain": 1.0,
    "actuator.rated_flow": 1.0,
    "actuator.leakage": 3.0,
    "actuator.leakage_coefficient": 3.0,
    "actuator.valve_frequency": 1.0,
    "actuator.valve_damping": 1.0,
    "actuator.dead_time": 1.0,
    "actuator.friction": 3.0,
    "specimen.friction.force": 1.0,
    "specimen.gap.width": 1.0,
    "specimen.gap.stiffness": 1.0,
    "specimen.duffing.cubic": 1.0,
}
"""How uncertain each parameter of a rig is, in units of the spread; new ones go to the end."""


def perturbed_rig(
    section: Section, axes: Sequence[str], seed: int, number: int, spread: float
) -> Section:
    """Parameters of one of a row of rigs; number 0 is the configured rig itself.

    Each parameter p of `UNCERTAINTY` becomes p (1 + uncertainty spread)^d with its own d, even
    between -1 and 1: with a spread of 0.2, stiffness is up to 20 % too high or too low, and
    damping up to twice or half. Actuators differ from axis to axis; the matrices of the specimen
    are scaled as a whole. What is zero stays so. The seed of the sensor noise is drawn too.

    Parameters
    ----------
    section : dict
        Values of every parameter of the rig.
    axes : sequence of str
        Names of the axes; n of them.
    seed, number : int
        What is drawn depends on these two alone.
    spread : float
        At least 0.
    """
    if number == 0:
        return dict(section)
    random = np.random.default_rng([seed, number])
    drawn: Section = {"seed": int(random.integers(2**31))}
    for name, uncertainty in UNCERTAINTY.items():
        factors = (1.0 + uncertainty * spread) ** random.uniform(-1.0, 1.0, len(axes))
        of_each_axis = name.startswith("actuator.") and TABLE.rows[name].kind == "floats"
        if of_each_axis and len(axes) > 1:
            drawn[name] = (per_axis(section[name], axes, f"rig: {name}") * factors).tolist()
        else:
            drawn[name] = _scaled(section[name], float(factors[0]))
    return section | drawn


def check_rig(section: Section, axes: tuple[str, ...], timebase: Timebase, number: int) -> None:
    """Refuse parameters that make no rig.

    Raises
    ------
    InputError
        Names the rig's number where it is not the configured one.
    """
    try:
        Rig.from_parameters(TABLE.check(section), axes, timebase)
    except InputError as error:
        if number == 0:
            raise
        raise InputError(
            f"perturbed rig {number}: {error}; a smaller spread keeps rigs possible"
        ) from None


def _scaled(value: Value, factor: float) -> Value:
    return [factor * item for item in value] if isinstance(value, list) else factor * value
