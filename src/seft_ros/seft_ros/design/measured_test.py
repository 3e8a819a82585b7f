"""One test of an identification: spectra of its signals, and the responses in them."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.signal
from seft_msgs_py.wire.topics import REFERENCE_FORCE, RIG_STATE, VALVE_COMMAND

from seft_ros.bags.record import Record
from seft_ros.design.loop_margins import BAND_HZ

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

_HANN_OVERLAP_GAIN = 0.947  # independent averages for each half-overlapped Hann segment


@dataclass(frozen=True)
class Spectra:
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


def spectra(signals: Floats, rate: float, segment: float) -> Spectra:
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
    averages = max(1.0, _HANN_OVERLAP_GAIN * count) if count > 1 else 1.0
    return Spectra(frequencies, np.moveaxis(density, -1, 0), averages)


def response(
    measured: Spectra, inputs: slice, outputs: slice, band: tuple[float, float]
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


REFERENCE, VALVE, MOTION, FORCE = (0, 1), (1, 2), (2, 5), (4, 5)
"""Blocks of n signals, first and end: MOTION is displacement, acceleration and force."""

MOTION_TO = 0.2
"""Share of the rate up to which displacement may be differentiated: beyond is aliasing."""

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
        self.steps = int(record.series[RIG_STATE.name].steps[-1]) + 1
        every = np.arange(self.steps)

        def columns(topic: str, row: int) -> Floats:
            """Signal at every step, interpolated where a sample was lost."""
            series = record.series[topic]
            values = series.values[:, row].T
            return np.stack([np.interp(every, series.steps, value) for value in values], axis=1)

        self._signals = [
            columns(REFERENCE_FORCE.name, 0),
            columns(VALVE_COMMAND.name, 0),
            *(columns(RIG_STATE.name, row) for row in (0, 2, 3)),
        ]
        segment = self.steps * self.dt / _SEGMENTS
        self._spectra = spectra(np.hstack(self._signals), 1.0 / self.dt, segment)
        self._band = max(band[0], _LEAST_PERIODS / segment), band[1]

    def at_limit(self) -> int:
        """Count the steps in which a valve command is at the controller's limit."""
        limit = self.record.experiment["force_controller"]["voltage_limit"]
        commands = np.abs(self.record.series[VALVE_COMMAND.name].values)
        return int((commands >= limit).any(axis=(1, 2)).sum())

    def incoherent(self) -> str:
        """Say on which axis the force is mostly noise where it is to be controlled, if any."""
        for axis, name in enumerate(self.axes):
            measured = self.of(REFERENCE, FORCE, axis)
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

    def response(
        self, inputs: tuple[int, int], outputs: tuple[int, int], share: float = 0.5
    ) -> Response:
        """Response within the band, up to a share of the sampling rate."""
        n = len(self.axes)
        these, those = (slice(first * n, end * n) for first, end in (inputs, outputs))
        band = self._band[0], min(self._band[1], share / self.dt)
        return response(self._spectra, these, those, band)

    def of_actuator(self, axis: int) -> tuple[Floats, Floats, Floats, Floats]:
        """Valve command, displacement, acceleration and force of one axis, shape (N,) each."""
        _, command, position, acceleration, force = (part[:, axis] for part in self._signals)
        return command, position, acceleration, force

    def of(self, inputs: tuple[int, int], outputs: tuple[int, int], axis: int) -> Measurement:
        """Response of one axis to its own input."""
        return self.response(inputs, outputs).of_axis(axis)
