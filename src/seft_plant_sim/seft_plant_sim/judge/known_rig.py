"""What rig and force controller know of actuators and specimen: facts in their sections."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.facts import POSITION_SERVO
from seft_msgs_py.config.parameter_table import mass_matrix, per_axis, symmetric_matrix
from seft_msgs_py.errors import InputError

from seft_plant_sim.lti import TransferFunction
from seft_plant_sim.rig_parameters import common_lag

ASSUMED_ACTUATOR = ("flow_gain", "oil_stiffness", "leakage", "force_capacity")
FLOW_GAIN, OIL_STIFFNESS, LEAKAGE, CAPACITY = range(len(ASSUMED_ACTUATOR))
"""Columns of an array of actuators."""
_FIND_IT = "find it with seft identify CONFIG, and give its model.yaml with --params-file"
_BESIDE = ("friction", "friction_velocity", "valve_frequency", "valve_damping", "dead_time")


def read_actuators(
    section: Mapping[str, Any], axes: tuple[str, ...], places: Sequence[int]
) -> dict[str, Floats]:
    """Read ``actuator.*``, for the axes at some places.

    Returns
    -------
    dict of str to ndarray
        `ASSUMED_ACTUATOR` and those of friction and valve, by name, shape (number of places,) each.
        The dead time is that from a command to the measured flow, with the lag of the measured
        state.
    """
    own = list(places)
    known = {
        name: per_axis(section[f"actuator.{name}"], axes, f"/**: actuator.{name}")[own]
        for name in (*ASSUMED_ACTUATOR, *_BESIDE)
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
            raise InputError(f"/**: actuator.{name} is not known: {_FIND_IT}")
    capacity = known["force_capacity"]
    known["force_capacity"] = np.where(capacity > 0.0, capacity, np.inf)
    return known


def command_limit(section: Mapping[str, Any]) -> float:
    """Largest command of a rig, in V; of a displacement servo, in m, also its displacement."""
    limit = float(section["limits.command"])
    if section["actuator.kind"] == POSITION_SERVO:
        limit = min(limit, float(section["limits.displacement"]))
    return limit


def fastest_command(section: Mapping[str, Any], dt: float) -> float:
    """Largest change of a displacement servo's command in a period of dt s, m; else infinite."""
    if section["actuator.kind"] != POSITION_SERVO:
        return math.inf
    return float(section["limits.displacement_rate"]) * dt


def known_responses(
    section: Mapping[str, Any], axes: tuple[str, ...], places: Sequence[int]
) -> list[TransferFunction]:
    """Give the responses of displacement servos from command to displacement, at some places.

    Raises
    ------
    InputError
        If they are not known, not stable, or answer at once.
    """
    name = "/**: actuator.response"
    late = np.atleast_1d(section["actuator.response.dead_time"])
    each = len(late) if len(late) > 1 else 1
    dead_time = per_axis(section["actuator.response.dead_time"], axes, f"{name}.dead_time")
    parts = []
    for part in ("numerator", "denominator"):
        values = np.atleast_1d(np.asarray(section[f"actuator.response.{part}"], dtype=np.float64))
        if len(values) % each:
            many = f"{len(values)} coefficients for {each} axes"
            raise InputError(f"{name}.{part} has {many}; give each as many")
        parts.append(np.broadcast_to(values.reshape(each, -1), (len(axes), len(values) // each)))
    responses = []
    for place in places:
        top, below = (np.trim_zeros(part[place], "f") for part in parts)
        if not len(top):
            raise InputError(f"{name} is not known: {_FIND_IT}")
        if len(top) >= len(below) or np.roots(below).real.max() >= 0.0 or not top[-1]:
            what = f"{top.tolist()} over {below.tolist()} is no response of a displacement servo"
            must = "it must be stable, have more poles than zeros, and follow at rest"
            raise InputError(f"{name}: {what}: {must}")
        responses.append(TransferFunction(tuple(top), tuple(below), float(dead_time[place])))
    return responses


def read_specimen(
    section: Mapping[str, Any], axes: tuple[str, ...], places: Sequence[int]
) -> tuple[Floats, Floats]:
    """Read mass (kg) and stiffness (N/m) on the rig, for the axes at some places, each (n, n)."""
    own = np.ix_(list(places), list(places))
    mass = mass_matrix(section["specimen.mass"], axes, "/**: specimen.mass")
    stiffness = symmetric_matrix(section["specimen.stiffness"], axes, "/**: specimen.stiffness")
    return np.ascontiguousarray(mass[own]), np.ascontiguousarray(stiffness[own])
