"""Parameters of a servo-hydraulic actuator: identified ones, or what data sheets say.

Oil column, valve flow and leakage after Merritt (Hydraulic Control Systems, 1967, ch. 6).
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.arrays import per_axis
from seft_msgs_py.errors import InputError

from seft_plant_sim.specimen import Specimen

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Hydraulics:
    """What the actuators of n axes do to the oil's force, each array of shape (n,).

    Attributes
    ----------
    oil_stiffness : ndarray
        k_oil, stiffness of the oil column, N/m.
    leakage : ndarray
        lambda, rate at which leakage lets a force decay, 1/s.
    flow_gain : ndarray
        q, piston velocity for one volt without load, m/s/V.
    opening_limit : ndarray
        Drive in V at which the valve is fully open.
    force_capacity : ndarray
        F_s, force at which the supply pressure is used up, N.
    valve_frequency, valve_damping : ndarray
        Natural frequency in Hz and damping ratio of the valve.
    friction, friction_velocity : ndarray
        Coulomb friction of the piston in N, and the velocity in m/s over which it builds up.
    viscous_friction : ndarray
        Viscous friction of the piston, N s/m.
    stroke : ndarray
        Largest displacement either way, m.
    dead_time : float
        Dead time of the valve in s.
    """

    oil_stiffness: Floats
    leakage: Floats
    flow_gain: Floats
    opening_limit: Floats
    force_capacity: Floats
    valve_frequency: Floats
    valve_damping: Floats
    friction: Floats
    friction_velocity: Floats
    viscous_friction: Floats
    stroke: Floats
    dead_time: float

    @classmethod
    def from_parameters(
        cls, group: dict[str, Any], specimen: Specimen, axes: Sequence[str], where: str
    ) -> "Hydraulics":
        """Make it of the parameters ``actuator.*``.

        Where ``oil_stiffness`` (or ``oil_column_frequency``), ``flow_gain``, ``leakage`` and
        ``force_capacity`` are given they count; else they follow from the data sheets.

        Raises
        ------
        InputError
            If sizes do not fit the axes, or values contradict each other.
        """

        def value(name: str) -> Floats:
            return per_axis(group[name], axes, f"{where}.{name}")

        area, supply, bulk = (value(n) for n in ("piston_area", "supply_pressure", "bulk_modulus"))
        volume, voltage = value("oil_volume"), value("rated_voltage")
        compliance = volume / (4.0 * bulk)  # m^3/Pa: volume flow that raises the load pressure
        no_load = np.sqrt(supply / value("rated_pressure_drop"))  # rated flow is at that drop
        oil_stiffness = value("oil_stiffness")
        frequency = value("oil_column_frequency")
        if (oil_stiffness > 0).any() and (frequency > 0).any():
            raise InputError(
                f"{where}: oil_stiffness and oil_column_frequency are both given; give one"
            )
        mass, stiffness = np.diag(specimen.mass), np.diag(specimen.stiffness)
        of_frequency = mass * (2 * np.pi * frequency) ** 2 - stiffness
        if ((frequency > 0) & (of_frequency <= 0)).any():
            raise InputError(
                f"{where}.oil_column_frequency is {group['oil_column_frequency']}, but must be "
                "above the specimen's own frequency: the oil's spring acts beside the specimen's"
            )
        oil_stiffness = np.where(frequency > 0, of_frequency, oil_stiffness)
        return cls(
            oil_stiffness=_given_or(oil_stiffness, area**2 / compliance),
            leakage=_given_or(value("leakage"), value("leakage_coefficient") / compliance),
            flow_gain=_given_or(
                value("flow_gain"), value("rated_flow") * no_load / (area * voltage)
            ),
            opening_limit=voltage,
            force_capacity=_given_or(value("force_capacity"), supply * area),
            valve_frequency=value("valve_frequency"),
            valve_damping=value("valve_damping"),
            friction=value("friction"),
            friction_velocity=value("friction_velocity"),
            viscous_friction=value("viscous_friction"),
            stroke=value("stroke"),
            dead_time=float(group["dead_time"]),
        )

    def part(self, places: Sequence[int]) -> "Hydraulics":
        """Take the actuators at some places among the axes."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        own = list(places)
        return Hydraulics(
            **{k: v[own] if isinstance(v, np.ndarray) else v for k, v in values.items()}  # type: ignore[arg-type]
        )


def _given_or(given: Floats, from_data_sheet: Floats) -> Floats:
    return np.where(given > 0, given, from_data_sheet)
