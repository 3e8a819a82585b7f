"""What rig and force controller know of actuators and specimen: facts in their sections."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.parameter_table import mass_matrix, per_axis, symmetric_matrix
from seft_msgs_py.errors import InputError

from seft_plant_sim.rig_parameters import common_lag

ASSUMED_ACTUATOR = ("flow_gain", "oil_stiffness", "leakage", "force_capacity")
"""Columns of an array of actuators."""
_VALVE = ("valve_frequency", "valve_damping", "dead_time")


def read_actuators(
    section: Mapping[str, Any], axes: tuple[str, ...], places: Sequence[int]
) -> dict[str, Floats]:
    """Read ``actuator.*``, for the axes at some places.

    Returns
    -------
    dict of str to ndarray
        `ASSUMED_ACTUATOR` and those of the valve, by name, shape (number of places,) each. The dead
        time is that from a command to the measured flow, with the lag of the measured state.
    """
    own = list(places)
    known = {
        name: per_axis(section[f"actuator.{name}"], axes, f"/**: actuator.{name}")[own]
        for name in (*ASSUMED_ACTUATOR, *_VALVE)
    }
    known["dead_time"] = known["dead_time"] + common_lag(section)
    return known


def known_actuators(
    section: Mapping[str, Any], axes: tuple[str, ...], places: Sequence[int]
) -> dict[str, Floats]:
    """Give what `read_actuators` reads; an InputError says if the actuators are not known."""
    known = read_actuators(section, axes, places)
    for name in ("flow_gain", "oil_stiffness", "valve_frequency", "valve_damping"):
        if not known[name].all():
            raise InputError(
                f"/**: actuator.{name} is not known: find it with seft identify CONFIG, and give "
                "its model.yaml with --params-file"
            )
    capacity = known["force_capacity"]
    known["force_capacity"] = np.where(capacity > 0.0, capacity, np.inf)
    return known


def read_specimen(
    section: Mapping[str, Any], axes: tuple[str, ...], places: Sequence[int]
) -> tuple[Floats, Floats]:
    """Read mass (kg) and stiffness (N/m) on the rig, for the axes at some places, each (n, n)."""
    own = np.ix_(list(places), list(places))
    mass = mass_matrix(section["specimen.mass"], axes, "/**: specimen.mass")[own]
    stiffness = symmetric_matrix(section["specimen.stiffness"], axes, "/**: specimen.stiffness")[
        own
    ]
    return (
        np.ascontiguousarray(mass),
        np.ascontiguousarray(stiffness),
    )
