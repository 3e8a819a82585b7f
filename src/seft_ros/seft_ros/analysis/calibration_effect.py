"""What a wrong mass, scale or lag would have done to a test: displacement errors.

If the mass or a channel was not as the test knows it, the test was the exact one for another ground
motion (`seft_ros.analysis.equivalent_motion`). The effect of a deviation is what that change of the
motion would have changed, by the law that the specimen had (`seft_ros.analysis.specimen_law`).

Which of two channels is wrong can't be seen from their disagreement, so the worse case counts:

- mass: either the mass is m times the known one, or the force is m times too large;
- scale and lag of acceleration and velocity against the displacement: the displacement is wrong,
  and the specimen moved otherwise than its target by the difference. The computed part would see
  less of a wrong acceleration; a wrong velocity misleads the valve as a wrong displacement does;
- lag of the force behind the acceleration: the force is late;
- scale of the force, where the mass was identified by it: both are wrong, and nothing shows it.
"""

from copy import copy

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.wire.topics import RIG_STATE
from seft_plant_sim.whole_structure import reference_response, whole_structure

from seft_ros.analysis.equivalent_motion import EquivalentMotion, assumed_structure
from seft_ros.analysis.specimen_law import SpecimenLaw, springs_of
from seft_ros.ground_motion.conditioning import moved_ahead
from seft_ros.ground_motion.ground_motion_block import GroundMotion

_A, _F = (RIG_STATE.quantities.index(name) for name in ("accelerations", "effort"))


def calibration_structure(experiment: Experiment) -> Experiment | None:
    """Give the assumed structure; with a computed model, the specimen alone."""
    assumed = assumed_structure(experiment)
    if assumed is None and "reference_force" in experiment.sections:
        section = experiment["reference_force"] | {"method": "eft", "mass_ratio": 0.0}
        alone = Experiment({**experiment.sections, "reference_force": section})
        return assumed_structure(alone)
    return assumed


class CalibrationEffect:
    """Displacement errors that deviations mean, over the displacement, RMS over all axes.

    Parameters
    ----------
    structure : Experiment
        That of the test, see `calibration_structure`.
    samples : ndarray
        Displacement, velocity, acceleration and force as measured, shape (N, 4, n), every step.
    dt : float
        Sampling period, s.

    Attributes
    ----------
    springs : ndarray
        Deformation of each of the specimen's springs per displacement, shape (p, n).
    mass : ndarray
        Of the specimen as it is known, shape (n, n), kg.
    """

    def __init__(self, structure: Experiment, samples: Floats, dt: float) -> None:
        self._samples, self._dt = samples, dt
        self._whole = whole_structure(structure)
        equivalent, n = EquivalentMotion(self._whole, dt), samples.shape[2]
        self.mass = equivalent.mass
        self.springs = springs_of(structure, self._whole)
        self._total = self._whole.structure.mass[:n, :n]
        self._motion = equivalent.advance(samples)
        self._part = slice(None)
        self._law = SpecimenLaw(self._whole, self.mass, samples, self.springs, dt)

    def within(self, part: slice) -> "CalibrationEffect":
        """Give the same for deviations that are there in these samples alone."""
        own = copy(self)
        own._part = part
        return own

    def _of(self, change: Floats) -> float:
        """Error for a change of the ground motion, shape (N, n), m/s^2."""
        if not change.any():
            return 0.0
        there = np.zeros_like(change)
        there[self._part] = change[self._part]
        return self._law.difference(there)

    def of_mass(self, factor: Floats) -> float:
        """Error if the mass is so many times the known one, or the force too large; shape (n,)."""
        if (factor == 1.0).all():
            return 0.0
        true = self._total + (factor - 1.0)[:, np.newaxis] * self.mass
        by_mass = self._motion @ np.linalg.solve(true, self._total).T - self._motion
        return max(self._of(by_mass), self._of_force((1.0 / factor - 1.0) * self._samples[:, _F]))

    def of_force_scale(self, factor: Floats) -> float:
        """Error if force and mass are so many times too large, shape (n,): f / s and M_e / s."""
        if (factor == 1.0).all():
            return 0.0
        off = 1.0 - 1.0 / factor
        force = self._motion @ self.mass.T + self._samples[:, _F]
        true = self._total - off[:, np.newaxis] * self.mass
        of_force = off * force @ np.linalg.inv(true).T
        if np.linalg.norm(of_force) < 1e-9 * np.linalg.norm(self._motion):  # EFT: rounding
            return 0.0
        return self._of(of_force)

    def of_force_lag(self, lag: Floats) -> float:
        """Error if the force is late by so much, shape (n,), s."""
        return self._of_force(led(self._samples[:, _F], lag, self._dt))

    def of_zero(self, force: Floats, acceleration: Floats) -> float:
        """Error if the channels' zeros are off by so much, shape (N, n) or (n,), N and m/s^2."""
        if not (np.any(force) or np.any(acceleration)):
            return 0.0
        states = np.zeros_like(self._samples)
        states[:, _F], states[:, _A] = -force, -acceleration
        return self._of(EquivalentMotion(self._whole, self._dt).advance(states))

    def _of_force(self, change: Floats) -> float:
        return self.of_zero(-change, np.zeros(len(self.mass)))

    def of_scale(self, scale: Floats) -> float:
        """Error if the displacement is wrong by such a scale and tilt, shape (n, n)."""
        true = np.linalg.inv(scale)
        return self._of(self._samples[:, _A] @ (true - np.eye(len(true))).T)

    def of_lag(self, lag: Floats) -> float:
        """Error if the displacement leads the acceleration by so much, shape (n,), s."""
        return self._of(led(self._samples[:, _A], lag, self._dt))


def effect_of_force(experiment: Experiment, factor: float) -> float | None:
    """Error of an experiment if its load cells show so many times the force, and told the mass.

    By the known linear specimen, over the displacement, RMS over all axes; None if not known.
    """
    structure = calibration_structure(experiment)
    if structure is None:
        return None
    dt, axes = experiment.timebase.dt, experiment.axes
    motion = GroundMotion.from_parameters(experiment["ground_motion"], axes, experiment.timebase)
    exact = reference_response(structure, motion.samples)
    samples = np.stack([exact.displacement, exact.velocity, exact.acceleration, exact.force], 1)
    return CalibrationEffect(structure, samples, dt).of_force_scale(np.full(len(axes), factor))


def led(y: Floats, lead: Floats, dt: float) -> Floats:
    """Give y(t + lead) - y(t) of signals of shape (N, n), leads of shape (n,) in s."""
    return moved_ahead(y, lead, dt) - y if lead.any() else np.zeros_like(y)
