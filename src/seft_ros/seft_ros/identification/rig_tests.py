"""The tests of an identification: levels, motions and experiments."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config import facts
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import CHANNELS, EVERY_NODE, FORCE_DRIVEN, POSITION_SERVO
from seft_msgs_py.config.parameter_table import Section, group, mass_matrix
from seft_msgs_py.errors import InputError
from seft_plant_sim.judge.detector_list import MODEL_BASED, NOISE_BASED
from seft_plant_sim.judge.known_rig import command_limit
from seft_plant_sim.limits import Limits, largest_force_rate, span_steps
from seft_plant_sim.rig import Rig
from seft_plant_sim.rig_parameters import truth
from seft_plant_sim.simulated.specimen import Specimen
from seft_plant_sim.whole_structure import response

from seft_ros.bags.recording import Recording
from seft_ros.force_controller.force_controller_parameters import FOLLOW_TARGETS, one_controller
from seft_ros.force_controller.methods import force_control
from seft_ros.ground_motion.conditioning import check_size
from seft_ros.ground_motion.synthetic_motion import excitation, shortest_duration
from seft_ros.reference_force.reference_force_block import ReferenceForce

TAIL = 1.0
"""Rest after the excitation, s."""

PILOT_DURATION = 15.0
"""Duration of the test that finds the amplitude of the open loop, s."""

PEAK_SHARE = 0.5
"""Of a limit or a sensor's range that a peak may reach by plan."""

_PILOT_SHARE = 0.005  # of the voltage limit, RMS
_TARGET = 0.22  # of the limit that is used most: its largest share in the open loop
_ACCELERATION = 5.0  # m/s^2 RMS of a free mass under the default force
_FORCE_SHARE = 0.05  # of the force limit, at most
_CAP = "--max-displacement"


@dataclass(frozen=True)
class Levels:
    """RMS of the excitation: command in the open loop, V or m; force in the closed loop, N."""

    voltage: float
    force: float


@dataclass(frozen=True)
class LargestLevels:
    """Largest RMS that an excitation may have, each with the parameter that says so.

    The unit is that of the commands.
    """

    voltage: tuple[float, str]
    force: tuple[float, str]
    unit: str = "V"

    @classmethod
    def of(
        cls, experiment: Experiment, unit: Floats, cap: float, specimen: Specimen | None = None
    ) -> "LargestLevels":
        """Levels at which the peaks and changes of an excitation reach a limit.

        Of one of unit RMS, shape (N, n), see `excitation`; or at which, as far as is known, the
        displacement reaches a cap, m. The specimen is by default the one that is configured.
        """
        dt, limits = experiment.timebase.dt, group(experiment["supervisor"], "limits")
        steps, peak = span_steps(dt), float(np.abs(unit).max())
        at_rest = np.zeros((steps, unit.shape[1]))
        fastest = float(np.abs(unit - np.concatenate([at_rest, unit[:-steps]])).max()) / steps / dt
        largest = command_limit(experiment["force_controller"])
        limit = "displacement" if largest < limits["command"] else "command"
        voltages = [(largest / peak, f"/**: limits.{limit}")]
        forces = [
            (limits["force"] / peak, "/**: limits.force"),
            (largest_force_rate(limits) / fastest, "/**: limits.force_rate"),
        ]
        if cap < math.inf:
            voltages.append((cap / _moved_by_valves(experiment, unit), _CAP))
            forces.append((cap / _moved_by_forces(experiment, unit, specimen), _CAP))
        unit_of_command = facts.command_unit(experiment["reference_force"]["actuator.kind"])
        return cls(min(voltages), min(forces), unit_of_command)

    def check(self, levels: Levels) -> None:
        """Refuse levels that are not above 0, or beyond these, by an InputError."""
        for option, level, unit, (largest, where) in (
            ("--amplitude", levels.voltage, self.unit, self.voltage),
            ("--force", levels.force, "N", self.force),
        ):
            if not 0 < level <= largest:
                digit = 10.0 ** (math.floor(math.log10(largest)) - 2)
                most = f"{digit * math.floor(largest / digit):g} {unit} at most"
                text = f"{option} is {level:g} {unit} RMS, but must be above 0, and {most}"
                raise InputError(f"{text}: beyond, this excitation exceeds {where}")


def default_force(experiment: Experiment, largest: LargestLevels) -> float:
    """RMS of the reference force that moves the specimen well, far inside its limits, N."""
    limit = experiment["supervisor"]["limits.force"]
    wanted = _ACCELERATION * np.diag(known_mass(experiment)).min()
    return float(min(wanted, _FORCE_SHARE * limit, PEAK_SHARE * largest.force[0]))


def _moved_by_valves(experiment: Experiment, unit: Floats) -> float:
    """Largest displacement under valve commands, m, of shape (N, n), V.

    Where the flow gain is not known, the whole command is taken to give the limit of the velocity.
    """
    if obeys_displacement(experiment):
        return float(np.abs(unit).max())
    limits = group(experiment["supervisor"], "limits")
    gain = np.ravel(experiment["force_controller"]["actuator.flow_gain"])
    gain = np.where(gain > 0.0, gain, limits["velocity"] / limits["command"])
    return float(np.abs(gain * experiment.timebase.dt * np.cumsum(unit, axis=0)).max())


def _moved_by_forces(experiment: Experiment, unit: Floats, specimen: Specimen | None) -> float:
    """Largest displacement of a specimen under forces, m, of shape (N, n), N."""
    if specimen is None:
        known = group(experiment["reference_force"], "specimen")
        specimen = Specimen.from_parameters(known, experiment.axes, "/**: specimen")
    ground = -np.linalg.solve(specimen.mass, unit.T).T
    return float(np.abs(response(specimen, ground, experiment.timebase.dt)[0]).max())


def pilot_voltage(experiment: Experiment, largest: LargestLevels) -> float:
    """RMS of the valve command in the pilot test of an unknown rig, V."""
    limit = command_limit(experiment["force_controller"])
    return float(min(_PILOT_SHARE * limit, _TARGET * largest.voltage[0]))


def voltage_after(pilot: Recording, voltage: float, largest: LargestLevels) -> float:
    """RMS of the valve command that moves a rig well, far inside its limits, V.

    After a pilot test, open loop with an RMS of ``voltage`` V.
    """
    states, experiment = pilot.states.values, pilot.experiment
    dt, axes = experiment.timebase.dt, experiment.axes
    limits = Limits(group(experiment["supervisor"], "limits"), axes, dt)
    changes = states[len(limits.recent) :] - states[: -len(limits.recent)]
    largest_of = [np.abs(part).max(axis=(0, 2)) for part in (states, changes)]
    shares = largest_of / limits.values.reshape(2, -1)
    factor = min(_TARGET / shares[0].max(), PEAK_SHARE / shares[1].max())
    return float(min(voltage * factor, PEAK_SHARE * largest.voltage[0]))


def known_mass(experiment: Experiment) -> Floats:
    """Give the configured mass matrix, kg."""
    mass = experiment["reference_force"]["specimen.mass"]
    return mass_matrix(mass, experiment.axes, "/**: specimen.mass")


def has_valve(experiment: Experiment) -> bool:
    """Whether a valve drives the rig."""
    return experiment["reference_force"]["actuator.kind"] not in FORCE_DRIVEN


def obeys_displacement(experiment: Experiment) -> bool:
    """Whether a displacement servo drives the rig: commands are in m."""
    return experiment["reference_force"].get("actuator.kind") == POSITION_SERVO


def open_loop(
    experiment: Experiment, motion: Path, voltage: float, known_channels: bool = True
) -> Experiment:
    """Test that drives the valves by a record of ground motion, without force feedback.

    A reference force of 1 N, which nothing applies, is a command of ``voltage`` V. What that
    excites is no instability. Where channels are not known, as before a multisine test, nothing
    compares them: to judge and detectors they are as noisy as their limits are large. No command
    depends on what is measured, and the limits hold.
    """
    controller = one_controller([voltage], [1.0]) | {"feedback": False}
    changes: dict[str, Section] = {"reference_force": {"instability.ratio": 0.0}}
    if not known_channels:
        limits = group(experiment["supervisor"], "limits")
        changes[EVERY_NODE] = {f"sensors.{name}_noise": limits[name] for name in CHANNELS}
        changes["rig"] = truth(experiment.sections.get("rig", {}))
        changes["rig"]["detectors.warn_only"] = ",".join([*MODEL_BASED, *NOISE_BASED])
    return _with(experiment, motion, controller).changed(changes)


def multisine_test(experiment: Experiment, motion: Path) -> Experiment:
    """Test that drives the valves by a record whose forces in N are the commands in V."""
    return open_loop(experiment, motion, 1.0, known_channels=False)


def closed_loop_test(experiment: Experiment, motion: Path, force: float) -> Experiment:
    """Test that follows the reference force of a record, times ``force``, by its own controller."""
    return _with(experiment, motion, {"feedback": True}, force)


def has_force_loop(experiment: Experiment) -> bool:
    """Whether the force controller follows a reference force, without a target's motion."""
    return experiment["force_controller"]["method"] not in FOLLOW_TARGETS


def _with(
    experiment: Experiment, motion: Path, controller: Section, force: float = 1.0
) -> Experiment:
    """Copy an experiment as one of conventional EFT under a ground motion, times ``force``."""
    changes: dict[str, Section] = {
        "ground_motion": {
            "file": str(motion.resolve()),
            "column": list(range(len(experiment.axes))),
            "rows": False,
            "correct": "none",
            "unit": "m/s2",
            "dt": experiment.timebase.dt,
            "peak_force": 0.0,
            "time_scale": 1.0,
            "influence": [force],
            "tail": TAIL,
        },
        "reference_force": {"method": "eft", "mass_ratio": 0.0, "compensation.method": "none"},
        # a bias that these tests find is beside the known
        EVERY_NODE: {"calibration.zeroing": 0.0},
        "rig": {"detectors.warn_only": ",".join(MODEL_BASED)},
        "force_controller": controller,
    }
    return experiment.changed(changes)


def ground_of(experiment: Experiment, forces: Floats) -> Floats:
    """Ground accelerations a_g of reference forces -M a_g, shape (N, n) both, m/s^2 and N."""
    accelerations: Floats = -np.linalg.solve(known_mass(experiment), forces.T).T
    return accelerations


def write_forces(path: Path, experiment: Experiment, forces: Floats) -> Path:
    """Write a motion with reference forces -M a_g of shape (N, n), in N; give its path.

    It is a record that ground_motion reads exactly. The folder is made if need be. An InputError
    says if it can't be written.
    """
    accelerations = ground_of(experiment, forces)
    names = [f"axis {index + 1} (m/s2)" for index in range(accelerations.shape[1])]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savetxt(path, accelerations, "%.17g", ",", header=",".join(names))
    except OSError as error:
        raise InputError(f"{error.filename}: {error.strerror or error}") from None
    return path


@dataclass(frozen=True)
class Motions:
    """Ground motions of any duration for the tests of one identification.

    Attributes
    ----------
    experiment : Experiment
        What is identified.
    band, seed : tuple of float, int
        As `excitation` takes them.
    cap : float
        Displacement that no test shall exceed, m; beside the limits.
    """

    experiment: Experiment
    band: tuple[float, float]
    seed: int
    cap: float = math.inf

    def of_pilot(self, duration: float) -> float:
        """Duration of the pilot of a test, s."""
        return min(duration, max(PILOT_DURATION, shortest_duration(self.band)))

    def largest_levels(self, duration: float, specimen: Specimen | None = None) -> LargestLevels:
        """Largest levels of a test, see `LargestLevels.of`."""
        return LargestLevels.of(self.experiment, self.unit(duration), self.cap, specimen)

    def check(self, duration: float) -> None:
        """Refuse by an InputError tests that can't be made, before anything is written or moves."""
        self.unit(duration)
        sections = self.experiment.sections
        made = self.experiment.axes, self.experiment.timebase
        ReferenceForce.from_parameters(sections["reference_force"], *made)
        if has_force_loop(self.experiment):
            force_control(sections["force_controller"], *made)
        if "rig" in sections:
            Rig(sections["rig"], *made)

    def write(self, path: Path, duration: float) -> Path:
        """Write the motion of a test, whose forces are the excitation, 1 N RMS."""
        return write_forces(path, self.experiment, self.unit(duration))

    def steps(self, duration: float) -> int:
        """Count the steps of a test with such a motion."""
        return round((duration + TAIL) * self.experiment.timebase.rate)

    def unit(self, duration: float) -> Floats:
        """Excitation of unit RMS of a test, shape (N, n)."""
        time, axes = self.experiment.timebase, len(self.experiment.axes)
        check_size(duration, time.rate, "--duration")
        steps = round(duration * time.rate)
        servo = obeys_displacement(self.experiment)
        return excitation(steps, axes, time.dt, self.band, self.seed, servo)
