"""One test of an identification, as spectra of its signals."""

import numpy as np
import numpy.typing as npt
from seft_msgs_py.wire.topics import REFERENCE_FORCE, RIG_STATE, VALVE_COMMAND

from seft_ros.identification.measurement import Measurement
from seft_ros.identification.spectral import Response, response, segment_duration, spectra
from seft_ros.loop_shaping.margins import BAND_HZ
from seft_ros.recording.record import Record

Floats = npt.NDArray[np.float64]

REFERENCE, VALVE, MOTION, FORCE = (0, 1), (1, 2), (2, 5), (4, 5)
"""Blocks of n signals, first and end: MOTION is displacement, acceleration and force."""

MOTION_TO = 0.2
"""Share of the rate up to which displacement may be derived: beyond, folded motion spoils it."""

_LEAST_PERIODS = 3.0  # of the lowest frequency in a segment
_COHERENT = 0.5
_LEAST_SHARE = 0.5  # of the frequencies that must be coherent


class MeasuredTest:
    """Spectra of reference force, valve, displacement, acceleration and force in one test.

    Parameters
    ----------
    record : Record
        The test, run to its end.
    band : tuple of float
        Lowest and highest frequency of its excitation, Hz.
    """

    def __init__(self, record: Record, band: tuple[float, float]) -> None:
        self.record = record
        self.axes = record.experiment.axes
        self.dt = record.experiment.timebase.dt
        last = int(record.series[RIG_STATE.name].steps[-1])
        self.steps = last + 1
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
        segment = segment_duration(len(every) * self.dt)
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
        command, position, acceleration, force = (part[:, axis] for part in self._signals[1:])
        return command, position, acceleration, force

    def of(self, inputs: tuple[int, int], outputs: tuple[int, int], axis: int) -> Measurement:
        """Response of one axis to its own input."""
        found = self.response(inputs, outputs)
        return Measurement(
            found.frequencies_hz,
            found.response[:, axis, axis],
            np.sqrt(np.maximum(found.variance()[:, axis, axis], 0.0)),
            found.coherence[:, axis],
        )
