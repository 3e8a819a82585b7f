"""The response of `whole_structure`, piece by piece while a test runs."""

import numpy as np
import numpy.typing as npt
from seft_msgs_py.experiment import Experiment

from seft_plant_sim.restoring_force import HystereticSpring
from seft_plant_sim.whole_structure import sampled_motion, whole_structure

Floats = npt.NDArray[np.float64]


class RunningResponse:
    """Response of a whole structure as its ground motion becomes known.

    Exact where the structure is linear. Where it yields, what its springs carry less than elastic
    ones acts like further ground motion, linear from step to step, and is found from a deformation
    that is predicted without its change: near enough to be looked at, and cheap enough for it.

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
        self._tested = whole_structure(experiment)
        whole = self._tested.structure
        self.exact = not whole.springs
        self._whole = whole
        self._free, self._start, self._change = sampled_motion(whole, experiment.timebase.dt)
        self._state = np.zeros(2 * whole.axes)
        self._last: Floats | None = None  # motion
        self._springs = [_SpringState(spring) for spring in whole.springs]
        self._share = np.linalg.solve(whole.mass, whole.deformation.T) if self._springs else None
        self._plastic = np.zeros(whole.axes)  # of the last step, as an acceleration

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
        shown, n, whole = ground_motion.shape[1], self._whole.axes, self._whole
        ground_motion = self._tested.motion(ground_motion)
        if self._last is None:  # at rest in the first step
            states = np.zeros((len(ground_motion), 2 * n))
            before, rest = ground_motion[:-1], states[1:]
        else:
            states = np.empty((len(ground_motion), 2 * n))
            before, rest = np.vstack([self._last, ground_motion[:-1]]), states
        after = ground_motion[len(ground_motion) - len(before) :]
        rest[:] = before @ self._start.T + (after - before) @ self._change.T
        plastic = np.zeros_like(ground_motion)
        state, free = self._state, self._free
        for step, driven in enumerate(rest, len(ground_motion) - len(rest)):
            driven += free.dot(state)
            if self._springs:
                plastic[step] = self._yield(driven)
            state = driven
        self._state, self._last = state.copy(), ground_motion[-1].copy()
        restoring = states[:, :n] @ whole.stiffness.T + states[:, n:] @ whole.damping.T
        acceleration = plastic - ground_motion - np.linalg.solve(whole.mass, restoring.T).T
        return states[:, :shown], acceleration[:, :shown]

    def _yield(self, state: Floats) -> Floats:
        """Bring a state to where its plastic forces take it; give these, over the mass, m/s^2."""
        state -= self._start.dot(self._plastic)
        deformation = (self._whole.deformation @ state[: self._whole.axes]).tolist()
        forces = [s.step(e) for s, e in zip(self._springs, deformation, strict=True)]
        assert self._share is not None
        new: Floats = self._share.dot(forces)
        state -= self._change.dot(new - self._plastic)
        self._plastic = new
        return new


class _SpringState:
    """Where a spring is on its path."""

    def __init__(self, law: HystereticSpring) -> None:
        self._law = law
        self._deformation = self._z = self._work = 0.0

    def step(self, deformation: float) -> float:
        """Follow it to a deformation (midpoint rule); give what it carries less than elastic, N."""
        law, change, z = self._law, deformation - self._deformation, self._z
        self._deformation = deformation
        if change:
            sign, h = (1.0, change) if change > 0.0 else (-1.0, -change)
            middle = z + 0.5 * h * law.trial_rate(z, sign, self._work)
            work = self._work + 0.5 * h * law.work_rate(z, sign)
            self._z = z = law.settle(z + h * law.trial_rate(middle, sign, work))
            self._work += h * law.work_rate(middle, sign)
        return law.stiffness * deformation - law.force(deformation, z)
