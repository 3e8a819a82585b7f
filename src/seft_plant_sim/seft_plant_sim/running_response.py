"""The response of `whole_structure`, piece by piece while a test runs."""

import numpy as np
import numpy.typing as npt
from seft_msgs_py.experiment import Experiment

from seft_plant_sim.response import ShakenStructure
from seft_plant_sim.whole_structure import whole_structure

Floats = npt.NDArray[np.float64]

STEPS = 16
"""Of the integration within a step where a structure yields: near enough to be looked at."""


class RunningResponse:
    """Response of a whole structure as its ground motion becomes known.

    Parameters
    ----------
    experiment : Experiment
        Resolved parameters, as for `reference_response`.

    Attributes
    ----------
    exact : bool
        Whether the structure is linear.
    """

    def __init__(self, experiment: Experiment) -> None:
        self._whole = whole_structure(experiment)
        structure = self._whole.structure
        self.exact = not structure.springs
        dt = experiment.timebase.dt
        self._shaken = ShakenStructure(structure, dt, 1 if self.exact else STEPS)

    def advance(self, ground_motion: Floats) -> tuple[Floats, Floats]:
        """Go on over the next N steps; the first of all is step 0, at rest.

        Parameters
        ----------
        ground_motion : ndarray
            Shape (N, n), N at least 1, m/s^2.

        Returns
        -------
        displacement, acceleration : ndarray
            Relative to the ground, shape (N, n), m and m/s^2.
        """
        n = ground_motion.shape[1]
        x, _, a, _ = self._shaken.advance(self._whole.motion(ground_motion))
        return x[:, :n], a[:, :n]
