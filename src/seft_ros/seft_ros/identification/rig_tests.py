"""The tests of an identification: levels, experiments, and the spectra of what was measured."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.signal
from seft_msgs_py.arrays import Complexes, Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.parameter_table import Section, group, mass_matrix
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import REFERENCE_FORCE, VALVE_COMMAND
from seft_plant_sim.rig import Rig
from seft_plant_sim.rig_parameters import LIMIT_NAMES
from seft_plant_sim.sensors import CHANNELS

from seft_ros.bags.record import Record, Series
from seft_ros.design.force_tracking import BAND_HZ
from seft_ros.force_controller.force_controller_parameters import (
    VELOCITY_FEEDFORWARD,
    one_controller,
)
from seft_ros.force_controller.methods import force_control
from seft_ros.ground_motion.resampling import check_size
from seft_ros.ground_motion.synthetic_motion import excitation, shortest_duration
from seft_ros.protection.detector_list import MODEL_BASED, NOISE_BASED
from seft_ros.reference_force.force_command import FORCE_DRIVEN
from seft_ros.reference_force.reference_force_block import ReferenceForce

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
        return Measurement(
            self.frequencies_hz,
            self.response[:, axis, axis],
            np.sqrt(np.maximum(self.variance()[:, axis, axis], 0.0)),
            self.coherence[:, axis],
        )


def motion_spectra(signals: Floats, rate: float, segment: float) -> _Spectra:
    """Cross-spectral densities by Welch's method: Hann windows, half overlapped.

    Of signals of shape (N, m), sampled at a rate in Hz, in segments of so many s.
    """
    length = min(int(segment * rate), len(signals))
    columns = signals.T
    frequencies, density = scipy.signal.csd(
        columns[:, np.newaxis],
        columns[np.newaxis],
        fs=rate,
        window="hann",
        nperseg=length,
        noverlap=length // 2,
        detrend=False,  # a drift is part of the signals
    )
    count = (len(signals) - length // 2) // (length - length // 2)
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


_REFERENCE, _VALVE, _MOTION, _FORCE = (0, 1), (1, 2), (2, 5), (4, 5)
# blocks of n signals, first and end: motion is displacement, acceleration and force
_MOTION_TO = 0.2  # of the rate: a displacement is differentiated, and beyond is aliasing
_SEGMENTS = 7.5  # to a record, before they overlap
_LEAST_PERIODS = 3.0  # of the lowest frequency in a segment
_COHERENT = 0.5
_LEAST_SHARE = 0.5  # of the frequencies that must be coherent


class MeasuredTest:
    """Spectra of reference force, valve, displacement, acceleration and force in one test.

    Of a record that ran to its end; the band is that of its excitation, in Hz.
    """

    def __init__(self, record: Record, band: tuple[float, float]) -> None:
        self.record = record
        self.axes = record.experiment.axes
        self.dt = record.experiment.timebase.dt
        self.steps = int(record.states.steps[-1]) + 1
        every = np.arange(self.steps)

        def columns(series: Series, row: int) -> Floats:
            """Signal at every step, interpolated where a sample was lost."""
            values = series.values[:, row].T
            return np.stack([np.interp(every, series.steps, value) for value in values], axis=1)

        self._signals = [
            columns(record.series[REFERENCE_FORCE.name], 0),
            columns(record.series[VALVE_COMMAND.name], 0),
            *(columns(record.states, row) for row in (0, 2, 3)),
        ]
        segment = self.steps * self.dt / _SEGMENTS
        self._spectra = motion_spectra(np.hstack(self._signals), 1.0 / self.dt, segment)
        self._band = max(band[0], _LEAST_PERIODS / segment), band[1]

    def at_limit(self) -> int:
        """Count the steps in which a valve command is at the controller's limit."""
        limit = self.record.experiment["force_controller"]["voltage_limit"]
        commands = np.abs(self.record.series[VALVE_COMMAND.name].values)
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
                return (
                    f"coherence of the force on axis {name} is below {_COHERENT:g} at "
                    f"{poor.mean():.0%} of the frequencies from {bad[0]:.3g} to {bad[-1]:.3g} Hz, "
                    "too low to identify anything"
                )
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
        """Response of displacement, acceleration and force to the reference force."""
        return self._response(_REFERENCE, _MOTION, _MOTION_TO)

    def plant(self, axis: int) -> Measurement:
        """Response of the force of an axis to its valve."""
        return self._response(_VALVE, _FORCE).of_axis(axis)

    def tracking(self, axis: int) -> Measurement:
        """Response of the force of an axis to its reference force."""
        return self._response(_REFERENCE, _FORCE).of_axis(axis)

    def of_actuator(self, axis: int) -> tuple[Floats, Floats, Floats, Floats]:
        """Valve command, displacement, acceleration and force of one axis, shape (N,) each."""
        _, command, position, acceleration, force = (part[:, axis] for part in self._signals)
        return command, position, acceleration, force


TAIL = 1.0
"""Rest after the excitation, s."""

PILOT_DURATION = 15.0
"""Duration of the test that finds the amplitude of the open loop, s."""

_PILOT_SHARE = 0.005  # of the voltage limit, RMS
_LARGEST_SHARE = 0.1
_TARGET = 0.22  # of the limit that is used most: its largest share in the open loop
_ACCELERATION = 5.0  # m/s^2 RMS of a free mass under the default force
_FORCE_SHARE = 0.05  # of the force limit, at most
_PEAKS = 4.5  # largest value of Gaussian noise over its RMS, in a minute at 500 Hz


@dataclass(frozen=True)
class Levels:
    """RMS of the excitation: valve command in the open loop, V; force in the closed loop, N."""

    voltage: float
    force: float


def default_force(experiment: Experiment, band: tuple[float, float]) -> float:
    """RMS of the reference force that moves the specimen well, far inside its limits, N."""
    limit = experiment["supervisor"]["limits.force"]
    wanted = _ACCELERATION * np.diag(_mass(experiment)).min()
    return float(min(wanted, _FORCE_SHARE * limit, _largest_force(experiment, band)))


def _largest_force(experiment: Experiment, band: tuple[float, float]) -> float:
    """RMS of a force with a flat spectrum up to the band's end whose peaks change in time, N."""
    rms_of_rate = 2.0 * math.pi * max(band[1], 1e-3) / math.sqrt(3.0)  # over that of the force
    return float(experiment["reference_force"]["limits.force_rate"] / (_PEAKS * rms_of_rate))


def pilot_voltage(experiment: Experiment) -> float:
    """RMS of the valve command in the pilot test of an unknown rig, V."""
    return float(_PILOT_SHARE * experiment["force_controller"]["voltage_limit"])


def voltage_after(pilot: Record, voltage: float) -> float:
    """RMS of the valve command that moves a rig well, far inside its limits, V.

    After a pilot test, open loop with an RMS of ``voltage`` V.
    """
    states = pilot.states.values
    limits = group(pilot.experiment["supervisor"], "limits")
    largest = np.abs(states).max(axis=(0, 2)) / [limits[name] for name in LIMIT_NAMES]
    most = _LARGEST_SHARE * pilot.experiment["force_controller"]["voltage_limit"]
    return float(min(voltage * _TARGET / max(largest), most))


def check_levels(experiment: Experiment, levels: Levels, band: tuple[float, float]) -> None:
    """Refuse levels whose peaks exceed the limits of the experiment, by an InputError."""
    if levels.force > (largest := _largest_force(experiment, band)):
        raise InputError(
            f"--force is {levels.force:g} N RMS, which in a band up to {band[1]:g} Hz changes "
            f"faster than reference_force limits.force_rate; give {largest:.3g} N at most, or a "
            "lower --band"
        )
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


def _mass(experiment: Experiment) -> Floats:
    mass = experiment["reference_force"]["model.mass"]
    return mass_matrix(mass, experiment.axes, "reference_force: model.mass")


def has_valve(experiment: Experiment) -> bool:
    """Whether a valve drives the rig; also true if the rig is not simulated here."""
    return experiment.sections.get("rig", {}).get("actuator.kind") not in FORCE_DRIVEN


def open_loop(
    experiment: Experiment, record: Path, levels: Levels, known_channels: bool = True
) -> Experiment:
    """Test that drives the valves by a record of ground motion, without force feedback.

    The motion's reference force has an RMS of ``levels.force``, the commands get
    ``levels.voltage``. Where channels are not known, as before a shake, nothing compares them: to
    judge and detectors they are as noisy as their limits are large. No command depends on what is
    measured, and the limits hold.
    """
    controller = one_controller([levels.voltage / levels.force], [1.0]) | {"feedback": False}
    if not known_channels:
        limits = group(experiment["supervisor"], "limits")
        noise = zip(CHANNELS, (limits[name] for name in LIMIT_NAMES), strict=True)
        controller |= {f"noise.{channel}": largest for channel, largest in noise}
        controller["detectors.warn_only"] = ",".join([*MODEL_BASED, *NOISE_BASED])
    return _with(experiment, record, controller)


def shake_test(experiment: Experiment, record: Path) -> Experiment:
    """Test that drives the valves by a record whose forces in N are the commands in V.

    What it excites is no instability: nothing is fed back.
    """
    test = open_loop(experiment, record, Levels(1.0, 1.0), known_channels=False)
    return changed(test, {"reference_force": {"instability.ratio": 0.0}})


def closed_loop_test(experiment: Experiment, record: Path) -> Experiment:
    """Test that follows the record's reference force by the experiment's own controller."""
    return _with(experiment, record, {"feedback": True})


def has_force_loop(experiment: Experiment) -> bool:
    """Whether the force controller follows a reference force, without a target's motion."""
    method = experiment["force_controller"].get("method")  # not in an older record
    return method != VELOCITY_FEEDFORWARD


def changed(experiment: Experiment, changes: Mapping[str, Section]) -> Experiment:
    """Copy an experiment with other values: node -> parameter -> value."""
    return experiment.changed({n: own for n, own in changes.items() if n in experiment.sections})


def _with(experiment: Experiment, record: Path, controller: Section) -> Experiment:
    """Copy an experiment as one of conventional EFT under a ground motion."""
    own = experiment["force_controller"]
    # by default these follow what changes here
    kept = {name: own[name] for name in ("detectors.test", "detectors.mass_ratio") if name in own}
    changes: dict[str, Section] = {
        "ground_motion": {
            "file": str(record.resolve()),
            "column": list(range(len(experiment.axes))),
            "rows": False,
            "correct": "none",
            "unit": "m/s2",
            "dt": experiment.timebase.dt,
            "peak_force": 0.0,
            "time_scale": 1.0,
            "influence": [1.0],
            "tail": TAIL,
        },
        "reference_force": {"method": "eft", "mass_ratio": 0.0, "compensation.method": "none"},
        # a zero that these tests find is beside the told one
        "supervisor": {"rehearsal.zeroing": 0.0},
        "rig": {"calibration.zeroing": 0.0},
        "force_controller": {"detectors.warn_only": ",".join(MODEL_BASED)} | kept | controller,
    }
    return changed(experiment, changes)


def write_forces(path: Path, experiment: Experiment, forces: Floats) -> Path:
    """Write a motion with reference forces -M a_g of shape (N, n), in N; give its path.

    It is a record that ground_motion reads exactly. The folder is made if need be. An InputError
    says if it can't be written.
    """
    accelerations = -np.linalg.solve(_mass(experiment), forces.T).T
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
    force : float
        RMS of the reference force, N.
    band, seed : tuple of float, int
        As `excitation` takes them.
    """

    experiment: Experiment
    force: float
    band: tuple[float, float]
    seed: int

    @property
    def shortest(self) -> float:
        """Shortest duration for the band, s."""
        return shortest_duration(self.band)

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
        """Write the motion of a test, whose forces are the excitation; see `write_forces`."""
        return write_forces(path, self.experiment, self.force * self._unit(duration))

    def steps(self, duration: float) -> int:
        """Count the steps of a test with such a motion."""
        return round((duration + TAIL) * self.experiment.timebase.rate)

    def _unit(self, duration: float) -> Floats:
        time, axes = self.experiment.timebase, len(self.experiment.axes)
        check_size(duration, time.rate, "--duration")
        steps = round(duration * time.rate)
        return excitation(steps, axes, time.dt, self.band, self.seed)
