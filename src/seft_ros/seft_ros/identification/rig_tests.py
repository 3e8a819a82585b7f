"""The tests of an identification: ordinary experiments with their own ground motion."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.config.arrays import mass_matrix
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.parameter_table import group
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import RIG_STATE
from seft_plant_sim.limits import NAMES

from seft_ros.force_controller.kinds import one_controller
from seft_ros.force_controller.names import VELOCITY_FEEDFORWARD
from seft_ros.interlock.detectors import MODEL_BASED
from seft_ros.recording.record import Record
from seft_ros.target.force_command import FORCE_DRIVEN

Floats = npt.NDArray[np.float64]

TAIL = 1.0
"""Rest after the excitation, s."""

PILOT_DURATION = 15.0
"""Duration of the test that finds the amplitude of the open loop, s."""

_PILOT_SHARE = 0.005  # of the voltage limit, RMS
_LARGEST_SHARE = 0.1
_TARGET = 0.22  # of the limit that is used most: its largest share in the open loop
_ACCELERATION = 5.0  # m/s^2 RMS: what the default force gives a mass that is free
_CHIRP_SHARE = 0.3
_FORCE_SHARE = 0.05  # of the force limit, at most
_PEAKS = 4.5  # largest value of Gaussian noise over its RMS, in a minute at 500 Hz


@dataclass(frozen=True)
class Levels:
    """RMS of the excitation: valve command in the open loop, V; force in the closed loop, N."""

    voltage: float
    force: float


def default_force(experiment: Experiment, signal: str) -> float:
    """RMS of the reference force that moves the specimen well, far inside its limits, N.

    A chirp, which is all at one frequency at a time, gets less.
    """
    limit = experiment["supervisor"]["limits.force"]
    force = min(_ACCELERATION * np.diag(_mass(experiment)).min(), _FORCE_SHARE * limit)
    return float(force * (_CHIRP_SHARE if signal == "chirp" else 1.0))


def pilot_voltage(experiment: Experiment) -> float:
    """RMS of the valve command with which a rig that is not known yet is tried, V."""
    return float(_PILOT_SHARE * experiment["force_controller"]["voltage_limit"])


def voltage_after(pilot: Record, voltage: float) -> float:
    """RMS of the valve command that moves a rig well, far inside its limits, V.

    After a pilot test, open loop with an RMS of ``voltage`` V.
    """
    states = pilot.series[RIG_STATE.name].values
    limits = group(pilot.experiment["supervisor"], "limits")
    largest = np.abs(states).max(axis=(0, 2)) / [limits[name] for name in NAMES]
    most = _LARGEST_SHARE * pilot.experiment["force_controller"]["voltage_limit"]
    return float(min(voltage * _TARGET / max(largest), most))


def check_levels(experiment: Experiment, levels: Levels) -> None:
    """Refuse by an InputError levels whose peaks lie beyond what the experiment allows."""
    for option, level, unit, node, name in (
        ("--amplitude", levels.voltage, "V", "force_controller", "voltage_limit"),
        ("--force", levels.force, "N", "supervisor", "limits.force"),
    ):
        limit = experiment[node][name]
        if not 0 < _PEAKS * level <= limit:
            raise InputError(
                f"{option} is {level:g} {unit} RMS, but must be above 0, and its peaks, "
                f"{_PEAKS:g} times as large, within {node} {name}, {limit:g} {unit}"
            )


def ground_accelerations(experiment: Experiment, forces: Floats) -> Floats:
    """Ground motion (N, n) in m/s^2 whose reference forces -M a_g are these, in N."""
    accelerations: Floats = -np.linalg.solve(_mass(experiment), forces.T).T
    return accelerations


def _mass(experiment: Experiment) -> Floats:
    told = experiment["reference_force"]["model.mass"]
    return mass_matrix(told, experiment.axes, "reference_force: model.mass")


def has_valve(experiment: Experiment) -> bool:
    """Whether a valve drives the rig, as far as the experiment says."""
    return experiment.sections.get("rig", {}).get("actuator.kind") not in FORCE_DRIVEN


def open_loop(experiment: Experiment, record: Path, levels: Levels) -> Experiment:
    """Test that drives the valves by a record of ground motion, without force feedback.

    The motion's reference force has an RMS of ``levels.force``, the commands get
    ``levels.voltage``.
    """
    controller = one_controller([levels.voltage / levels.force], [1.0])
    return _with(experiment, record, controller | {"feedback": False})


def closed_loop(experiment: Experiment, record: Path) -> Experiment:
    """Test that follows the record's reference force by the experiment's own controller."""
    return _with(experiment, record, {"feedback": True})


def has_force_loop(experiment: Experiment) -> bool:
    """Whether the force controller follows a reference force, without a target's motion."""
    method = experiment["force_controller"].get("method")  # not in an older record
    return method != VELOCITY_FEEDFORWARD


def _with(experiment: Experiment, record: Path, controller: dict[str, Any]) -> Experiment:
    """Copy an experiment as one of conventional EFT under a ground motion."""
    changes: dict[str, dict[str, Any]] = {
        "ground_motion": {
            "file": str(record.resolve()),
            "column": list(range(len(experiment.axes))),
            "unit": "m/s2",
            "dt": experiment.timebase.dt,
            "peak_force": 0.0,
            "time_scale": 1.0,
            "influence": [1.0],
            "tail": TAIL,
        },
        "reference_force": {"method": "eft", "mass_ratio": 0.0, "compensation.method": "none"},
        "force_controller": {"detectors.warn_only": ",".join(MODEL_BASED)} | controller,
    }
    return Experiment(
        {node: {**own, **changes.get(node, {})} for node, own in experiment.sections.items()}
    )
