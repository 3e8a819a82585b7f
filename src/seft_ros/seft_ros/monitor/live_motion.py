"""The ground motion that a running test is of, against the one that is asked for."""

from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.config.experiment import Experiment
from seft_plant_sim.reference.whole_structure import RunningResponse, whole_structure

from seft_ros.analysis.equivalent_motion import (
    DAMPING,
    EquivalentMotion,
    assumed_structure,
    natural_frequencies,
    spectrum_frequencies,
)
from seft_ros.ground_motion.spectrum import RunningSpectrum

Floats = npt.NDArray[np.float64]


class LiveMotion:
    """Follows a test's own ground motion, its response spectrum, and a linear structure under it.

    Parameters
    ----------
    told : Experiment
        What is told of the structure, as `assumed_structure` gives it.
    """

    def __init__(self, told: Experiment) -> None:
        dt = told.timebase.dt
        self._equivalent = EquivalentMotion(whole_structure(told), dt)
        self._responses = RunningResponse(told), RunningResponse(told)
        self._natural = natural_frequencies(told)
        self._frequency = spectrum_frequencies((self._natural[0], self._natural[-1]), dt)
        self._spectra = RunningSpectrum(1 / self._frequency, dt, DAMPING)
        self._squares = np.zeros(2)  # of the response, and of the difference

    @classmethod
    def of(cls, experiment: Experiment) -> "LiveMotion | None":
        """Make one, if the structure is known."""
        told = assumed_structure(experiment)
        return None if told is None else cls(told)

    def advance(self, asked: Floats, states: Floats) -> None:
        """Go on over the next N steps.

        Parameters
        ----------
        asked : ndarray
            Ground acceleration, shape (N, n), m/s^2.
        states : ndarray
            As measured, shape (N, 4, n); NaN where there is none: what happened there counts as
            right.
        """
        missing = ~np.isfinite(states).all(axis=(1, 2))
        if missing.any():
            states = np.where(missing[:, np.newaxis, np.newaxis], 0.0, states)
        tested = self._equivalent.advance(states)
        tested[missing] = asked[missing]
        wanted, found = (
            response.advance(motion)[0]
            for response, motion in zip(self._responses, (asked, tested), strict=True)
        )
        with np.errstate(over="ignore", invalid="ignore"):  # of a test that went unstable
            self._squares += [np.sum(wanted**2), np.sum((found - wanted) ** 2)]
            self._spectra.advance(np.hstack([asked, tested]))

    def told(self) -> dict[str, Any]:
        """Make what the page shows of it so far, JSON values."""
        response, difference = self._squares
        n = self._spectra.spectrum.shape[1] // 2
        spectra = self._spectra.spectrum.T
        known = response > 0 and np.isfinite(self._squares).all() and np.isfinite(spectra).all()
        if not known:
            return {}
        return {
            "response_nrmse": float(np.sqrt(difference / response)),
            "natural_hz": self._natural.tolist(),
            "frequency_hz": np.round(self._frequency, 4).tolist(),
            "asked": np.round(spectra[:n], 4).tolist(),
            "tested": np.round(spectra[n:], 4).tolist(),
        }
