"""The valve-to-force response that identified actuators have on an identified specimen."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from seft_plant_sim.actuator.actuator import servo_hydraulic
from seft_plant_sim.actuator.hydraulics import Hydraulics
from seft_plant_sim.specimen.specimen import Specimen

from seft_ros.identification.actuator_fit import ActuatorFit
from seft_ros.identification.rational import Rational
from seft_ros.identification.specimen_fit import SpecimenFit
from seft_ros.loop_shaping.plant import Plant
from seft_ros.loop_shaping.roots import Root

Floats = npt.NDArray[np.float64]


def plants(specimen: SpecimenFit, actuators: Sequence[ActuatorFit]) -> list[Plant]:
    """Small-signal plant of each of n axes, the valves of the others closed."""
    n = len(actuators)

    def of_each(name: str) -> Floats:
        return np.array([getattr(actuator, name) for actuator in actuators])

    model = servo_hydraulic(
        Specimen(specimen.mass, specimen.damping, specimen.stiffness),
        Hydraulics(
            **{name: of_each(name) for name in ("oil_stiffness", "leakage", "flow_gain")},
            **{name: of_each(name) for name in ("valve_frequency", "valve_damping")},
            **dict.fromkeys(("opening_limit", "force_capacity", "stroke"), np.full(n, np.inf)),
            viscous_friction=of_each("drag"),
            friction=np.zeros(n),
            friction_velocity=np.ones(n),
            dead_time=0.0,
        ),
        linear=True,
    )
    force = slice(3 * n, 4 * n)
    whole = Plant("identified", model.a, model.b, model.c[force], model.d[force], 0.0)
    return [
        replace(whole.axis(axis), delay=actuator.dead_time)
        for axis, actuator in enumerate(actuators)
    ]


def transfer_function(plant: Plant, actuator: ActuatorFit) -> Rational:
    """Numerator and denominator of the plant of one axis."""
    # f' = k_oil q w and w'' = w_v^2 u at the highest frequencies
    gain = actuator.oil_stiffness * actuator.flow_gain * (2 * np.pi * actuator.valve_frequency) ** 2
    numerator, denominator = gain * _product(plant.zeros()), _product(plant.poles())
    return Rational(tuple(numerator.tolist()), tuple(denominator.tolist()), plant.delay)


def _product(roots: Iterable[Root]) -> Floats:
    result = np.ones(1)
    for root in roots:
        result = np.convolve(result, root.polynomial())
    return result
