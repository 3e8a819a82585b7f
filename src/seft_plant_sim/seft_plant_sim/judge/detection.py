"""The detectors of a force controller, and how near a test came to their thresholds."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats, Ints
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import CHANNELS, FORCE_DRIVEN
from seft_msgs_py.errors import InputError

from seft_plant_sim.judge.detector_list import ALL, DETECTORS
from seft_plant_sim.judge.detector_step import begin_detectors, detect_all
from seft_plant_sim.judge.detectors import (
    DetectorParameters,
    DetectorState,
    detector_arrays,
)
from seft_plant_sim.judge.known_rig import ASSUMED_ACTUATOR, read_actuators, read_specimen
from seft_plant_sim.judge.valve_model import valve_models
from seft_plant_sim.simulated.sensors import per_channel


def detectors_of(
    section: dict[str, Any], axes: tuple[str, ...], dt: float, places: Sequence[int]
) -> tuple[DetectorParameters, DetectorState]:
    """Put the detectors of some of the axes into arrays.

    Parameters
    ----------
    section : dict
        Of the force controller, for all axes.
    axes : tuple of str
        Names of all axes.
    dt : float
        Sampling period, s.
    places : sequence of int
        Of the watched axes.

    Raises
    ------
    InputError
        If assumed values do not fit the axes, or there is no detector of a given name.
    """
    own, names = list(places), [one.name for one in DETECTORS]
    listed = section["detectors.warn_only"].replace(",", " ").split()
    warn_only = names if listed == [ALL] else listed
    for name in warn_only:
        if name not in names:
            raise InputError(
                f"force_controller: detectors.warn_only: no detector {name!r}; there are "
                f"{', '.join(names)}"
            )
    actuator = read_actuators(section, axes, places)
    is_known = actuator["valve_frequency"] > 0.0
    actuator["flow_gain"] = np.where(is_known, actuator["flow_gain"], 0.0)
    actuator["valve_frequency"] = np.where(is_known, actuator["valve_frequency"], 1.0 / dt)
    mass, stiffness, ratio = read_specimen(section, axes, places)
    valves = valve_models(actuator, dt)
    noise, ranges = (
        np.ascontiguousarray(per_channel(section, axes, f"sensors.{{}}_{what}")[:, own])
        for what in ("noise", "range")
    )
    return detector_arrays(
        noise,
        np.array([section[f"limits.{name}"] for name in CHANNELS]),
        ranges,
        section["sensors.velocity"] == "derived",
        np.transpose([actuator[name] for name in ASSUMED_ACTUATOR]),
        np.array([valve.last_period() for valve in valves]),
        section["actuator.kind"] not in FORCE_DRIVEN,
        mass,
        stiffness,
        ratio * mass,
        warn_only,
        section["limits.command"],
        dt,
    )


def detector_shares(
    experiment: Experiment, steps: Ints, points: Floats, states: Floats
) -> dict[str, float]:
    """Give the largest value of each detector in a test, over its threshold.

    Parameters
    ----------
    experiment : Experiment
        Of the test.
    steps : ndarray
        Of the N answered samples, shape (N,).
    points, states : ndarray
        Reference force, and sample and drive of the rig at these; shapes (N, q, n) and (N, 5, n).

    Returns
    -------
    dict
        The largest share on any axis, by the detector's name.
    """
    section, axes, dt = experiment["force_controller"], experiment.axes, experiment.timebase.dt
    shares = np.zeros(len(DETECTORS))
    for rig in experiment.rigs:
        parameters, state = detectors_of(section, axes, dt, rig.places)
        own = list(rig.places)
        begin_detectors(parameters, state)
        detect_all(
            parameters,
            state,
            steps,
            np.ascontiguousarray(points[..., own]),
            np.ascontiguousarray(states[..., own]),
            np.empty_like(parameters.noise),
        )
        shares = np.maximum(shares, state.shares.max(axis=1))
    return {one.name: share for one, share in zip(DETECTORS, shares.tolist(), strict=True)}
