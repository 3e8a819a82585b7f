"""The judge and the detectors of a rig, made of its parameters."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from seft_msgs_py.config.facts import CHANNELS, FORCE_DRIVEN, POSITION_SERVO
from seft_msgs_py.errors import InputError

from seft_plant_sim.calibration import known_channels
from seft_plant_sim.channels import (
    ACCELERATION,
    acceleration_is_derived,
    per_channel,
    velocity_is_derived,
)
from seft_plant_sim.judge.detector_list import ALL, DETECTORS, TRACKING
from seft_plant_sim.judge.detectors import (
    DetectorParameters,
    DetectorState,
    KnownRig,
    detector_arrays,
)
from seft_plant_sim.judge.known_rig import (
    ASSUMED_ACTUATOR,
    command_limit,
    known_responses,
    read_actuators,
    read_specimen,
)
from seft_plant_sim.judge.servo_model import last_periods
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
    is_known &= section["actuator.kind"] != POSITION_SERVO  # its valve obeys no command of ours
    actuator["flow_gain"] = np.where(is_known, actuator["flow_gain"], 0.0)
    actuator["valve_frequency"] = np.where(is_known, actuator["valve_frequency"], 1.0 / dt)
    mass, stiffness = read_specimen(section, axes, places)
    past = np.array([valve.last_period() for valve in valve_models(actuator, dt)])
    imposes = section["actuator.kind"] == POSITION_SERVO
    imposes = imposes and bool(np.any(section["actuator.response.numerator"]))
    if imposes:
        past = last_periods(section, known_responses(section, axes, own))
    noise, ranges = (
        np.ascontiguousarray(per_channel(section, axes, f"sensors.{{}}_{what}")[:, own])
        for what in ("noise", "range")
    )
    if acceleration_is_derived(section):  # nothing else is compared with it, and no sensor ends it
        noise[ACCELERATION], ranges[ACCELERATION] = section["limits.acceleration"], 0.0
        mass, stiffness = np.zeros_like(mass), np.zeros_like(stiffness)
    bits = section["sensors.adc_bits"]
    channels = known_channels(section, axes)  # a range is of what a sensor shows
    bias, scale = (np.abs(channels[what][:, own]) for what in ("bias", "scale"))
    late = channels["lag"]
    known = KnownRig(
        noise=noise,
        limits=np.array([section[f"limits.{name}"] for name in CHANNELS]),
        ranges=(ranges - bias) / scale,
        steps=ranges * (2.0 ** (1 - bits) if bits else 0.0) / scale,
        velocity_is_derived=velocity_is_derived(section),
        actuator=np.transpose([actuator[name] for name in ASSUMED_ACTUATOR]),
        past=past,
        imposes=imposes,
        has_valve=section["actuator.kind"] not in FORCE_DRIVEN,
        mass=mass,
        stiffness=stiffness,
        largest_drive=command_limit(section),
        waits=np.ceil((late.max() - late[:, own]).max(axis=1) / dt).astype(np.int64),
        dt=dt,
    )
    return detector_arrays(known, warn_only, zeroed)
