"""The response of `whole_structure`, piece by piece while a test runs."""

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError
from seft_msgs_py.experiment import Experiment

from seft_plant_sim.whole_structure import sampled_motion, whole_structure

Floats = npt.NDArray[np.float64]


class RunningResponse:
    """Exact response of a linear whole structure as its ground motion becomes known.

    Parameters
    ----------
    experiment : Experiment
        Resolved parameters, as for `reference_response`.

    Raises
    ------
    InputError
        If the specimen yields: its response takes longer to solve than the test lasts.
    """

    def __init__(self, experiment: Experiment) -> None:
        whole = whole_structure(experiment)
        if whole.springs:
            raise InputError("the response of a specimen that yields is known after the test")
        self._whole = whole
        self._free, self._start, self._change = sampled_motion(whole, experiment.timebase.dt)
        self._state = np.zeros(2 * whole.axes)
        self._last: Floats | None = None

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
        n, whole = self._whole.axes, self._whole
        if self._last is None:  # at rest in the first step
            states = np.zeros((len(ground_motion), 2 * n))
            before, rest = ground_motion[:-1], states[1:]
        else:
            states = np.empty((len(ground_motion), 2 * n))
            before, rest = np.vstack([self._last, ground_motion[:-1]]), states
        after = ground_motion[len(ground_motion) - len(before) :]
        rest[:] = before @ self._start.T + (after - before) @ self._change.T
        state, free = self._state, self._free
        for driven in rest:
            driven += free.dot(state)
            state = driven
        self._state, self._last = state.copy(), ground_motion[-1].copy()
        restoring = states[:, :n] @ whole.stiffness.T + states[:, n:] @ whole.damping.T
        acceleration = -ground_motion - np.linalg.solve(whole.mass, restoring.T).T
        return states[:, :n], acceleration
