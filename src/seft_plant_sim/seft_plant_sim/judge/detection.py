"""The judge and the detectors of a rig, made of its parameters."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from seft_msgs_py.config.facts import CHANNELS, FORCE_DRIVEN
from seft_msgs_py.errors import InputError

from seft_plant_sim.calibration import known_channels
from seft_plant_sim.channels import per_channel, velocity_is_derived
from seft_plant_sim.judge.detector_list import ALL, DETECTORS, TRACKING
from seft_plant_sim.judge.detectors import (
    DetectorParameters,
    DetectorState,
    KnownRig,
    detector_arrays,
)
from seft_plant_sim.judge.known_rig import ASSUMED_ACTUATOR, read_actuators, read_specimen
from seft_plant_sim.judge.valve_model import valve_models


def warning_detectors(section: Mapping[str, Any]) -> list[str]:
    """Give the names of the detectors that do not end a test, of a section.

    Raises
    ------
    InputError
        If there is no detector of a given name.
    """
    names = [one.name for one in (*DETECTORS, TRACKING)]
    listed = section["detectors.warn_only"].replace(",", " ").split()
    for name in listed:
        if name not in (*names, ALL):
            raise InputError(
                f"rig: detectors.warn_only: no detector {name!r}; there are {', '.join(names)}"
            )
    return names if ALL in listed else listed


def detectors_of(
    section: dict[str, Any],
    axes: tuple[str, ...],
    dt: float,
    places: Sequence[int],
    zeroed: Mapping[str, Any] | None = None,
) -> tuple[DetectorParameters, DetectorState]:
    """Put the detectors of some of the axes into arrays.

    Parameters
    ----------
    section : dict
        Of the rig, for all axes.
    axes : tuple of str
        Names of all axes.
    dt : float
        Sampling period, s.
    places : sequence of int
        Of the watched axes.
    zeroed : mapping, optional
        What they measured at rest, see `seft_plant_sim.calibration.zeroed_at_rest`.

    Raises
    ------
    InputError
        If assumed values do not fit the axes, or there is no detector of a given name.
    """
    own, warn_only = list(places), warning_detectors(section)
    actuator = read_actuators(section, axes, places)
    is_known = actuator["valve_frequency"] > 0.0
    actuator["flow_gain"] = np.where(is_known, actuator["flow_gain"], 0.0)
    actuator["valve_frequency"] = np.where(is_known, actuator["valve_frequency"], 1.0 / dt)
    mass, stiffness = read_specimen(section, axes, places)
    valves = valve_models(actuator, dt)
    noise, ranges = (
        np.ascontiguousarray(per_channel(section, axes, f"sensors.{{}}_{what}")[:, own])
        for what in ("noise", "range")
    )
    bits = section["sensors.adc_bits"]
    channels = known_channels(section, axes)  # a range is of what a sensor shows
    bias, scale = (np.abs(channels[what][:, own]) for what in ("bias", "scale"))
    known = KnownRig(
        noise=noise,
        limits=np.array([section[f"limits.{name}"] for name in CHANNELS]),
        ranges=(ranges - bias) / scale,
        steps=ranges * (2.0 ** (1 - bits) if bits else 0.0) / scale,
        velocity_is_derived=velocity_is_derived(section),
        actuator=np.transpose([actuator[name] for name in ASSUMED_ACTUATOR]),
        past=np.array([valve.last_period() for valve in valves]),
        has_valve=section["actuator.kind"] not in FORCE_DRIVEN,
        mass=mass,
        stiffness=stiffness,
        largest_drive=section["limits.command"],
        dt=dt,
    )
    return detector_arrays(known, warn_only, zeroed)
