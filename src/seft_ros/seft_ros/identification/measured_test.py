"""What a test of an identification has measured: spectra, and the frequency responses in them."""

from dataclasses import dataclass, replace

import numpy as np
import scipy.signal
from seft_msgs_py.arrays import Complexes, Floats
from seft_msgs_py.wire.topics import REFERENCE_FORCE, VALVE_COMMAND
from seft_plant_sim.channels import acceleration_is_derived
from seft_plant_sim.judge.known_rig import command_limit

from seft_ros.bags.recording import Recording, every_step
from seft_ros.ground_motion.synthetic_motion import shortest_duration
from seft_ros.reference_force.compensator import OF_THE_LOOP

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
