"""What a force controller knows of actuators and specimen, from its section of an experiment."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.parameter_table import mass_matrix, per_axis, symmetric_matrix

ASSUMED_ACTUATOR = ("flow_gain", "oil_stiffness", "leakage", "force_capacity")
"""Columns of an array of actuators."""
_VALVE = ("valve_frequency", "valve_damping", "dead_time")
_WHERE = "force_controller: "


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
        name: per_axis(section[f"actuator.{name}"], axes, f"{_WHERE}actuator.{name}")[own]
        for name in (*ASSUMED_ACTUATOR, *_VALVE)
    }
    known["dead_time"] = known["dead_time"] + section["sensor_lag"]
    return known


def read_specimen(
    section: Mapping[str, Any], axes: tuple[str, ...], places: Sequence[int]
) -> tuple[Floats, Floats, float]:
    """Read mass (kg) and stiffness (N/m) on the rig, for the axes at some places, each (n, n).

    And the mass ratio of what is computed. In a test by conventional EFT the specimen carries all
    of the mass. What is not known is 0.
    """
    own = np.ix_(list(places), list(places))
    name, ratio = "detectors.specimen_stiffness", float(section["detectors.mass_ratio"])
    stiffness = symmetric_matrix(section[name], axes, _WHERE + name)[own]
    mass = np.zeros_like(stiffness)
    if np.any(section["detectors.specimen_mass"]):
        name = "detectors.specimen_mass"
        mass = mass_matrix(section[name], axes, _WHERE + name)[own]
    if section["detectors.test"] == "eft":
        mass, ratio = (1.0 + ratio) * mass, 0.0
    return np.ascontiguousarray(mass), np.ascontiguousarray(stiffness), ratio
