"""The tests of an identification: levels, experiments, and the spectra of what was measured."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import scipy.signal
from seft_msgs_py.arrays import Complexes, Floats
from seft_msgs_py.config import facts
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import CHANNELS, EVERY_NODE, FORCE_DRIVEN, POSITION_SERVO
from seft_msgs_py.config.parameter_table import Section, group, mass_matrix
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import REFERENCE_FORCE, VALVE_COMMAND
from seft_plant_sim.channels import acceleration_is_derived
from seft_plant_sim.judge.detector_list import MODEL_BASED, NOISE_BASED
from seft_plant_sim.judge.known_rig import command_limit
from seft_plant_sim.limits import Limits, largest_force_rate, span_steps
from seft_plant_sim.rig import Rig
from seft_plant_sim.rig_parameters import truth
from seft_plant_sim.simulated.specimen import Specimen
from seft_plant_sim.whole_structure import response

from seft_ros.bags.recording import Recording, every_step
from seft_ros.force_controller.force_controller_parameters import FOLLOW_TARGETS, one_controller
from seft_ros.force_controller.methods import force_control
from seft_ros.ground_motion.conditioning import check_size
from seft_ros.ground_motion.synthetic_motion import excitation, shortest_duration
from seft_ros.reference_force.compensator import OF_THE_LOOP
from seft_ros.reference_force.reference_force_block import ReferenceForce

BAND_HZ = 25.0
"""Upper end of the band in which force is to be controlled (paper sec. 3.2), Hz."""

_HANN_OVERLAP_GAIN = 0.947  # independent averages for each half-overlapped Hann segment


@dataclass(frozen=True)
class _Spectra:
    """Cross-spectral densities of m signals.

    Attributes
    ----------
    frequencies_hz : ndarray
        Shape (F,).
    density : ndarray
        Shape (F, m, m): element (i, j) is the mean of conj(X_i) X_j; Hermitian.
    averages : float
        Number of independent averages.
    """

    frequencies_hz: Floats
    density: Complexes
    averages: float


@dataclass(frozen=True)
class Measurement:
    """Measured frequency response on one axis.

    Attributes
    ----------
    frequencies_hz : ndarray
        Shape (F,), increasing.
    response, deviation : ndarray
        Response and its standard deviation, shape (F,).
    coherence : ndarray
        Multiple coherence, shape (F,), 0 to 1.
    """

    frequencies_hz: Floats
    response: Complexes
    deviation: Floats
    coherence: Floats


@dataclass(frozen=True)
class Response:
    """Measured frequency response of p outputs to n inputs.

    Attributes
    ----------
    frequencies_hz : ndarray
        Shape (F,).
    response : ndarray
        Shape (F, p, n), output over input.
    coherence : ndarray
        Multiple coherence of each output with all inputs, shape (F, p), 0 to 1.
    noise : ndarray
        Covariance density of the outputs' noise, not explained by the inputs, shape (F, p, p).
    input_gain : ndarray
        Variance of column j of the response per unit of noise, shape (F, n).
    """

    frequencies_hz: Floats
    response: Complexes
    coherence: Floats
    noise: Complexes
    input_gain: Floats

    def variance(self) -> Floats:
        """Variance of each element of the response, shape (F, p, n)."""
        power = np.einsum("fii->fi", self.noise).real
        return power[:, :, np.newaxis] * self.input_gain[:, np.newaxis, :]

    def of_axis(self, axis: int) -> Measurement:
        """Response of one output to the input of its place."""
        deviation = np.sqrt(np.maximum(self.variance()[:, axis, axis], 0.0))
        response, coherence = self.response[:, axis, axis], self.coherence[:, axis]
        return Measurement(self.frequencies_hz, response, deviation, coherence)


def motion_spectra(signals: Floats, rate: float, segment: float) -> _Spectra:
    """Cross-spectral densities by Welch's method: Hann windows, half overlapped.

    Of signals of shape (N, m), sampled at a rate in Hz, in segments of so many s.
    """
    length = min(int(segment * rate), len(signals))
    pairs, overlap = (signals.T[:, np.newaxis], signals.T[np.newaxis]), length // 2
    # a drift is part of the signals
    frequencies, density = scipy.signal.csd(*pairs, rate, "hann", length, overlap, detrend=False)
    count = (len(signals) - overlap) // (length - overlap)
    averages = max(1.0, _HANN_OVERLAP_GAIN * count)
    return _Spectra(frequencies, np.moveaxis(density, -1, 0), averages)


def frequency_response(
    measured: _Spectra, inputs: slice, outputs: slice, band: tuple[float, float]
) -> Response:
    """Response of some signals to others, H1 = S_yu S_uu^-1, unbiased by noise of the outputs.

    The slices say which signals are the n inputs and the p outputs; the band is in Hz.
    """
    low, high = band
    within = (measured.frequencies_hz >= low) & (measured.frequencies_hz <= high)
    density = measured.density[within]
    # element (i, j) of a density has the conjugate on i: S_yu in the usual writing is (u, y)
    s_uu = np.swapaxes(density[:, inputs, inputs], 1, 2)
    s_yu = np.swapaxes(density[:, inputs, outputs], 1, 2)
    s_yy = np.swapaxes(density[:, outputs, outputs], 1, 2)
    inverse = np.linalg.inv(s_uu)
    found = s_yu @ inverse
    explained = found @ np.conj(np.swapaxes(s_yu, 1, 2))
    total = np.einsum("fii->fi", s_yy).real
    share = np.einsum("fii->fi", explained).real / np.where(total > 0, total, 1.0)
    spare = measured.averages - s_uu.shape[1]
    noise = (s_yy - explained) * (measured.averages / spare if spare > 0 else 1.0)
    gain = np.einsum("fii->fi", inverse).real / measured.averages
    return Response(measured.frequencies_hz[within], found, np.clip(share, 0.0, 1.0), noise, gain)


_REFERENCE, _VALVE, _DISPLACEMENT, _MOTION, _FORCE = (0, 1), (1, 2), (2, 3), (2, 5), (4, 5)
# blocks of n signals, first and end: motion is displacement, acceleration and force
_MOTION_TO = 0.2  # of the rate: a displacement is differentiated, and beyond is aliasing
_SEGMENTS = 7.5  # to a recording, before they overlap
_LEAST_PERIODS = 3.0  # of the lowest frequency in a segment
_COHERENT = 0.5
_LEAST_SHARE = 0.5  # of the frequencies that must be coherent


class MeasuredTest:
    """Spectra of reference force, valve, displacement, acceleration and force in one test.

    Of a recording that ran to its end; the band is that of its excitation, in Hz.
    """

    def __init__(self, recording: Recording, band: tuple[float, float]) -> None:
        self.recording = recording
        self.axes = recording.experiment.axes
        self.dt = recording.experiment.timebase.dt
        self.steps = int(recording.states.steps[-1]) + 1
        series = recording.series[REFERENCE_FORCE.name], recording.series[VALVE_COMMAND.name]
        asked, driven, states = (
            every_step(each, np.arange(self.steps)) for each in (*series, recording.states)
        )
        self._signals = [asked[:, 0], driven[:, 0], *(states[:, row] for row in (0, 2, 3))]
        segment = self.steps * self.dt / _SEGMENTS
        self._spectra = motion_spectra(np.hstack(self._signals), 1.0 / self.dt, segment)
        self._band = max(band[0], _LEAST_PERIODS / segment), band[1]

    def at_limit(self) -> int:
        """Count the steps in which a valve command is at the controller's limit."""
        limit = command_limit(self.recording.experiment["force_controller"])
        commands = np.abs(self.recording.series[VALVE_COMMAND.name].values)
        return int((commands >= limit).any(axis=(1, 2)).sum())

    def incoherent(self) -> str:
        """Say on which axis the force is mostly noise where it is to be controlled, if any."""
        for axis, name in enumerate(self.axes):
            measured = self.tracking(axis)
            f = measured.frequencies_hz
            wanted = f <= max(BAND_HZ, 2 * f[0])
            poor = measured.coherence[wanted] < _COHERENT
            if poor.mean() > 1.0 - _LEAST_SHARE:
                bad = f[wanted][poor]
                share = f"{poor.mean() * 100:.0f} % of the frequencies"
                low = f"coherence of the force on axis {name} is below {_COHERENT:g} at {share}"
                band = f"from {bad[0]:.3g} to {bad[-1]:.3g} Hz"
                return f"{low} {band}, too low to identify anything"
        return ""

    def _response(
        self, inputs: tuple[int, int], outputs: tuple[int, int], share: float = 0.5
    ) -> Response:
        """Response within the band, up to a share of the sampling rate."""
        n = len(self.axes)
        these, those = (slice(first * n, end * n) for first, end in (inputs, outputs))
        band = self._band[0], min(self._band[1], share / self.dt)
        return frequency_response(self._spectra, these, those, band)

    def motion(self) -> Response:
        """Response of displacement, acceleration and force to the reference force.

        An acceleration without a sensor is that of the displacement, with its noise.
        """
        found = self._response(_REFERENCE, _MOTION, _MOTION_TO)
        if not acceleration_is_derived(self.recording.experiment["rig"]):
            return found
        n, f = len(self.axes), found.frequencies_hz
        shown = np.tile(np.eye(3 * n), (len(f), 1, 1))
        shown[:, n : 2 * n] = 0.0
        shown[:, n : 2 * n, :n] = -((2.0 * np.pi * f[:, np.newaxis, np.newaxis]) ** 2) * np.eye(n)
        noise = shown @ found.noise @ shown.swapaxes(1, 2)
        return replace(found, response=shown @ found.response, noise=noise)

    def plant(self, axis: int) -> Measurement:
        """Response of the force of an axis to its valve."""
        return self._response(_VALVE, _FORCE).of_axis(axis)

    def tracking(self, axis: int) -> Measurement:
        """Response of the force of an axis to its reference force."""
        return self._response(_REFERENCE, _FORCE).of_axis(axis)

    def servo(self, axis: int) -> Measurement:
        """Response of the displacement of an axis to its command, without the loop's step and hold.

        A command acts a period after the sample that it answers, and is held for another.
        """
        found = self._response(_VALVE, _DISPLACEMENT).of_axis(axis)
        late = found.frequencies_hz * self.dt
        loop = np.exp(-2j * np.pi * late * OF_THE_LOOP) * np.sinc(late)
        deviation = found.deviation / np.abs(loop)
        return replace(found, response=found.response / loop, deviation=deviation)

    def of_actuator(self, axis: int) -> tuple[Floats, Floats, Floats, Floats]:
        """Valve command, displacement, acceleration and force of one axis, shape (N,) each."""
        _, command, position, acceleration, force = (part[:, axis] for part in self._signals)
        return command, position, acceleration, force


def before_trip(recording: Recording, band: tuple[float, float]) -> Recording | None:
    """Cut a recording before its trip; None if too little is left for the band, Hz."""
    if recording.trip is None:
        return recording
    last = recording.trip.step - 1
    if last * recording.experiment.timebase.dt < shortest_duration(band):
        return None
    series = {name: one.until(last) for name, one in recording.series.items()}
    return replace(recording, series=series)


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
