"""The tests of an identification: their levels, and experiments with their own ground motion."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.parameter_table import group, mass_matrix
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import RIG_STATE
from seft_plant_sim.rig import Rig
from seft_plant_sim.rig_parameters import LIMIT_NAMES

from seft_ros.bags.record import Record
from seft_ros.force_controller.methods import force_control
from seft_ros.force_controller.parameters import VELOCITY_FEEDFORWARD, one_controller
from seft_ros.ground_motion.ground_motion_block import check_size
from seft_ros.ground_motion.synthetic_motion import excitation, shortest_duration
from seft_ros.protection.detectors import MODEL_BASED
from seft_ros.reference_force.force_command import FORCE_DRIVEN
from seft_ros.reference_force.reference_force_block import ReferenceForce

Floats = npt.NDArray[np.float64]

TAIL = 1.0
"""Rest after the excitation, s."""

PILOT_DURATION = 15.0
"""Duration of the test that finds the amplitude of the open loop, s."""

_PILOT_SHARE = 0.005  # of the voltage limit, RMS
_LARGEST_SHARE = 0.1
_TARGET = 0.22  # of the limit that is used most: its largest share in the open loop
_ACCELERATION = 5.0  # m/s^2 RMS of a free mass under the default force
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

    A chirp, which has one frequency at a time, gets less.
    """
    limit = experiment["supervisor"]["limits.force"]
    force = min(_ACCELERATION * np.diag(_mass(experiment)).min(), _FORCE_SHARE * limit)
    return float(force * (_CHIRP_SHARE if signal == "chirp" else 1.0))


def pilot_voltage(experiment: Experiment) -> float:
    """RMS of the valve command in the pilot test of an unknown rig, V."""
    return float(_PILOT_SHARE * experiment["force_controller"]["voltage_limit"])


def voltage_after(pilot: Record, voltage: float) -> float:
    """RMS of the valve command that moves a rig well, far inside its limits, V.

    After a pilot test, open loop with an RMS of ``voltage`` V.
    """
    states = pilot.series[RIG_STATE.name].values
    limits = group(pilot.experiment["supervisor"], "limits")
    largest = np.abs(states).max(axis=(0, 2)) / [limits[name] for name in LIMIT_NAMES]
    most = _LARGEST_SHARE * pilot.experiment["force_controller"]["voltage_limit"]
    return float(min(voltage * _TARGET / max(largest), most))


def check_levels(experiment: Experiment, levels: Levels) -> None:
    """Refuse levels whose peaks exceed the limits of the experiment, by an InputError."""
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
    return -np.linalg.solve(_mass(experiment), forces.T).T


def _mass(experiment: Experiment) -> Floats:
    mass = experiment["reference_force"]["model.mass"]
    return mass_matrix(mass, experiment.axes, "reference_force: model.mass")


def has_valve(experiment: Experiment) -> bool:
    """Whether a valve drives the rig; also true if the rig is not simulated here."""
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


def write_excitation(path: Path, accelerations: Floats, axes: Sequence[str]) -> None:
    """Write ground accelerations (N, n) in m/s^2 as a record that ground_motion reads exactly.

    The folder is made if need be. An InputError says if it can't be written.
    """
    rows = [",".join(map(repr, row)) for row in accelerations.tolist()]
    names = ",".join(f"axis {index + 1} (m/s2)" for index in range(len(axes)))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("\n".join([f"# {names}", *rows, ""]), encoding="utf-8")
    except OSError as error:
        raise InputError(f"{error.filename}: {error.strerror or error}") from None


@dataclass(frozen=True)
class Motions:
    """Ground motions of any duration for the tests of one identification.

    Attributes
    ----------
    experiment : Experiment
        What is identified.
    force : float
        RMS of the reference force, N.
    signal, band, seed : str, tuple of float, int
        As `excitation` takes them.
    """

    experiment: Experiment
    force: float
    signal: str
    band: tuple[float, float]
    seed: int

    @property
    def shortest(self) -> float:
        """Shortest duration for the band, s."""
        return shortest_duration(self.signal, len(self.experiment.axes), self.band)

    def check(self, duration: float) -> None:
        """Refuse by an InputError tests that can't be made, before anything is written or moves."""
        self._unit(duration)
        sections = self.experiment.sections
        made = self.experiment.axes, self.experiment.timebase
        ReferenceForce.from_parameters(sections["reference_force"], *made)
        if has_force_loop(self.experiment):
            force_control(sections["force_controller"], *made)
        if "rig" in sections:
            Rig.from_parameters(sections["rig"], *made)

    def write(self, path: Path, duration: float) -> Path:
        """Write the motion of a test as a record, see `write_excitation`."""
        accelerations = ground_accelerations(self.experiment, self.force * self._unit(duration))
        write_excitation(path, accelerations, self.experiment.axes)
        return path

    def steps(self, duration: float) -> int:
        """Count the steps of a test with such a motion."""
        return round((duration + TAIL) * self.experiment.timebase.rate)

    def _unit(self, duration: float) -> Floats:
        time, axes = self.experiment.timebase, len(self.experiment.axes)
        check_size(duration, time.rate, "--duration")
        steps = round(duration * time.rate)
        return excitation(self.signal, steps, axes, time.dt, self.band, self.seed)
