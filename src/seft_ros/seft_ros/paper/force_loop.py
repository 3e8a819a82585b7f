"""The force loop as identified: measured curves and those of the fitted model side by side."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter

from seft_ros.identification.identified import Identified
from seft_ros.identification.spectral import Measurement
from seft_ros.loop_shaping.design import LoopDesign

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

_OUTLIERS = 5  # points of the running median over a measured magnitude
_ZERO_HZ = (2.0, 40.0)  # where the zero of a plant like the paper's is looked for
_SMOOTHED = 9


@dataclass(frozen=True)
class ForceLoop:
    """Responses of the force loop of one axis.

    Attributes
    ----------
    plant, tracking : Measurement
        Valve to force (N/V), and reference force to force, by spectral identification.
    model : LoopDesign
        The fitted rational form in the digital loop, with the experiment's controller.
    dt : float
        Sampling period, s.
    """

    plant: Measurement
    tracking: Measurement
    model: LoopDesign
    dt: float

    def controller(self, frequencies_hz: Floats) -> Complexes:
        """C_f as it runs, V/N, same shape."""
        return self.model.controller.sampled_response(frequencies_hz, self.dt)

    def measured_loop(self) -> Complexes:
        """C_f H_fu at the frequencies of ``plant``."""
        return self.controller(self.plant.frequencies_hz) * self.plant.response

    def roots_hz(self) -> tuple[float, float]:
        """Zero of the model's plant and its oil column, Hz; NaN where there is none."""
        roots = self.model.plant.antiresonance(), self.model.plant.oil_column()
        zero, pole = (root.hz if root else float("nan") for root in roots)
        return zero, pole

    def least_hz(self) -> float:
        """Frequency at which the measured plant answers least about its zero, Hz."""
        f = self.plant.frequencies_hz
        near = (f >= _ZERO_HZ[0]) & (f <= _ZERO_HZ[1])
        power = np.convolve(np.abs(self.plant.response) ** 2, np.ones(_SMOOTHED), "same")
        return float(f[near][power[near].argmin()])

    def gain_db(self, hz: float) -> float:
        """|L| of the model at one frequency, dB."""
        return float(np.interp(hz, self.model.frequencies_hz, self._decibels()))

    def largest_db(self, from_hz: float) -> float:
        """Largest |L| of the model from a frequency on, dB."""
        return float(self._decibels()[self.model.frequencies_hz >= from_hz].max())

    def largest_rise_db(self, low_hz: float, high_hz: float) -> float:
        """How far |L| of the model rises above where it has been, between two frequencies, dB."""
        f = self.model.frequencies_hz
        decibels = self._decibels()[(f >= low_hz) & (f <= high_hz)]
        return float((decibels - np.minimum.accumulate(decibels)).max())

    def unevenness_db(self, to_hz: float) -> float:
        """Largest departure of the measured |T| from 1 up to a frequency, dB."""
        known = self.tracking.frequencies_hz <= to_hz
        magnitude = 20 * np.log10(np.abs(self.tracking.response))
        return float(np.abs(median_filter(magnitude, _OUTLIERS, mode="nearest")[known]).max())

    def mismatch(self, to_hz: float) -> tuple[float, float]:
        """Largest difference of measured T and the model's up to a frequency: dB, degrees."""
        known = self.tracking.frequencies_hz <= to_hz
        f = self.tracking.frequencies_hz[known]
        own, modelled = self.model.frequencies_hz, self.model.sampled.tracking
        expected = np.interp(f, own, modelled.real) + 1j * np.interp(f, own, modelled.imag)
        ratio = self.tracking.response[known] / expected
        decibels = median_filter(20 * np.log10(np.abs(ratio)), _OUTLIERS, mode="nearest")
        degrees = median_filter(np.angle(ratio, deg=True), _OUTLIERS, mode="nearest")
        return float(np.abs(decibels).max()), float(np.abs(degrees).max())

    def _decibels(self) -> Floats:
        decibels: Floats = 20 * np.log10(np.abs(self.model.sampled.loop))
        return decibels


def force_loop(identified: Identified, dt: float) -> ForceLoop:
    """Take the force loop of the first axis from what was identified."""
    valve, closed = identified.valves[0], identified.closed_loops[0]
    return ForceLoop(valve.measured, closed.measured, valve.loop, dt)
