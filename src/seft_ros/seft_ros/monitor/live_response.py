"""Reference response of a running test, and the ground motion that it really tests."""

from typing import Any

import numpy as np
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.parameter_table import Floats
from seft_plant_sim.whole_structure import RunningResponse, whole_structure

from seft_ros.analysis.equivalent_motion import (
    DAMPING,
    EquivalentMotion,
    assumed_structure,
    natural_frequencies,
    spectrum_frequencies,
)
from seft_ros.ground_motion.response_spectrum import RunningSpectrum

MOST_AT_ONCE = 4000
"""Steps: some milliseconds of work, also while it catches up with a test."""


class _Motion:
    """Ground motion from step 0 on, as it is published; what was used is forgotten."""

    def __init__(self) -> None:
        self._coming: list[Floats] = []
        self._known = self.used = 0  # steps

    def add(self, first: int, values: Floats) -> None:
        if first == self._known:  # without the first chunks nothing is known of the rest
            self._coming.append(values)
            self._known += len(values)

    def take(self, until: int) -> Floats | None:
        """Take what follows, up to a step."""
        count = min(until, self._known) - self.used
        if count <= 0:
            return None
        self.used += count
        found, rest = np.split(np.concatenate(self._coming), [count])
        self._coming = [rest]
        return found


class LiveReference:
    """Follows the ground motion of one test after another.

    The first of a test's motion arrives before the test begins; a monitor that starts later gets
    all of it if the publisher still has all.

    Attributes
    ----------
    response : RunningResponse or None
        None: the structure is not known.
    """

    def __init__(self) -> None:
        self.response: RunningResponse | None = None
        self._now: _Motion | None = None
        self._coming: _Motion | None = None
        self._running = False

    def begin(self, response: RunningResponse | None) -> None:
        """Begin a test."""
        self.response = response
        if self._coming is not None or (self._now is not None and self._now.used):
            self._now, self._coming = self._coming, None
        self._running = True

    def motion(self, first: int, values: Floats) -> None:
        """Take in ground motion from a step on, shape (N, n), m/s^2."""
        if first == 0:
            if self._running and (self._now is None or not self._now.used):
                self._now = _Motion()
            else:
                self._coming = _Motion()
        target = self._coming or self._now
        hopeless = target is self._now and self._running and self.response is None
        if target is not None and not hopeless:
            target.add(first, values)

    def advance(self, until: int) -> tuple[int, Floats, Floats, Floats] | None:
        """Go on to a step, as far as the motion is known and time allows.

        Returns
        -------
        first : int
            Step from which the response is new.
        motion, displacement, acceleration : ndarray
            Ground motion and response to it, shape (N, n), m and m/s^2; None if there is nothing
            new.
        """
        if self._now is None or self.response is None:
            return None
        first = self._now.used
        motion = self._now.take(min(until, first + MOST_AT_ONCE))
        return None if motion is None else (first, motion, *self.response.advance(motion))


class LiveMotion:
    """Follows a test's own ground motion, its response spectrum, and a linear structure under it.

    Parameters
    ----------
    assumed : Experiment
        Assumed structure, see `assumed_structure`.
    """

    def __init__(self, assumed: Experiment) -> None:
        dt = assumed.timebase.dt
        self._equivalent = EquivalentMotion(whole_structure(assumed), dt)
        self._responses = RunningResponse(assumed), RunningResponse(assumed)
        self._natural = natural_frequencies(assumed)
        self._frequency = spectrum_frequencies((self._natural[0], self._natural[-1]), dt)
        self._spectra = RunningSpectrum(1 / self._frequency, dt, DAMPING)
        self._squares = np.zeros(2)  # of the response, and of the difference

    @classmethod
    def of(cls, experiment: Experiment) -> "LiveMotion | None":
        """Make one, if the structure is known."""
        assumed = assumed_structure(experiment)
        return None if assumed is None else cls(assumed)

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
        tested = self._equivalent.advance(np.where(missing[:, None, None], 0.0, states))
        tested[missing] = asked[missing]
        wanted, found = (
            response.advance(motion)[0]
            for response, motion in zip(self._responses, (asked, tested), strict=True)
        )
        with np.errstate(over="ignore", invalid="ignore"):  # of a test that went unstable
            self._squares += [np.sum(wanted**2), np.sum((found - wanted) ** 2)]
            self._spectra.advance(np.hstack([asked, tested]))

    def summary(self) -> dict[str, Any]:
        """Give what the page shows of it so far, JSON values."""
        response, difference = self._squares
        spectra = self._spectra.spectrum.T
        if not (response > 0 and np.isfinite(difference) and np.isfinite(spectra).all()):
            return {}
        asked, tested = np.split(np.round(spectra, 4), 2)
        return {
            "response_nrmse": float(np.sqrt(difference / response)),
            "natural_hz": self._natural.tolist(),
            "frequency_hz": np.round(self._frequency, 4).tolist(),
            "asked": asked.tolist(),
            "tested": tested.tolist(),
        }
