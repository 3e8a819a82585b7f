"""Mass, scales and lags of a test from its own samples, and what they would have done to it.

The estimates are those of `seft_ros.analysis.channel_estimates`. What a deviation means for the test
is the response to the change of its equivalent ground motion: if the mass or a channel was not as it
was told, the test was the exact one for another motion (`seft_ros.analysis.equivalent_motion`). Which
of two channels is wrong can't be told from their disagreement, so the worse case counts:

- mass: either the mass is m times the one told, or the force is m times too large;
- scale and lag of acceleration and velocity against displacement: the displacement may be the wrong
  one, so that the specimen moved otherwise than the target by the difference. The computed part sees
  less of a wrong acceleration. A wrong velocity misleads the valve as a wrong displacement does;
- lag of the force behind the acceleration: the force.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import RIG_STATE
from seft_plant_sim.specimen import deformations
from seft_plant_sim.whole_structure import WholeStructure, reference_response, whole_structure

from seft_ros.analysis.channel_estimates import (
    Inertia,
    Relation,
    inertia,
    motion_frequency,
    relation,
)
from seft_ros.analysis.equivalent_motion import (
    EquivalentMotion,
    assumed_structure,
    damping_factor,
    stiffness_factors,
)
from seft_ros.analysis.metrics import every_step, ratio
from seft_ros.bags.record import Record
from seft_ros.design.plan import choose_rig
from seft_ros.reference_force.force_command import FORCE_DRIVEN

SIGMAS = 4.0
"""Standard errors beyond which a deviation counts: of a law that is not described exactly 3 are too
few (docs/metrics.md)."""
MOST_LOST = 0.01
"""Share of samples that may be lost: they are interpolated, which is no measurement."""
_COUPLED = 1e-6  # of the largest stiffness: less is rounding
_X, _V, _A, _F = (
    RIG_STATE.quantities.index(name)
    for name in ("positions", "velocities", "accelerations", "effort")
)


@dataclass(frozen=True)
class IdentifiedMass:
    """Mass and lag of the force as a separate test of the specimen found them.

    Attributes
    ----------
    factor, factor_error : ndarray
        Mass over the one told, and its standard error, shape (n,).
    lag, lag_error : ndarray
        Of the force behind the acceleration, and its standard error, shape (n,), s.
    """

    factor: Floats
    factor_error: Floats
    lag: Floats
    lag_error: Floats


@dataclass(frozen=True)
class CalibrationCheck:
    """Estimates of a test, and the displacement errors that they mean; None: not known.

    Attributes
    ----------
    axes : tuple of str
        Names of the n axes.
    mass : ndarray
        M as it was told, shape (n, n), kg.
    inertia : Inertia or None
        Mass, and lag of the force behind the acceleration.
    acceleration, velocity : Relation or None
        Against the displacement.
    effect : dict
        ``mass``, ``scale``, ``lag`` -> displacement error (RMS over RMS) that the estimates mean;
        of estimates within `SIGMAS` standard errors of what they should be, 0.
    unsure : float or None
        The same of an error of the mass of `SIGMAS` standard errors.
    """

    axes: tuple[str, ...]
    mass: Floats
    inertia: Inertia | None
    acceleration: Relation | None
    velocity: Relation | None
    effect: dict[str, float | None]
    unsure: float | None

    def numbers(self) -> dict[str, Any]:
        """For JSON; docs/metrics.md explains each number."""
        return {
            "effect": self.effect,
            "unsure": self.unsure,
            "axes": {axis: self._of_axis(i) for i, axis in enumerate(self.axes)},
        }

    def _of_axis(self, i: int) -> dict[str, Any]:
        found: dict[str, Any] = {"mass": None, "force": None}
        if self.inertia is not None:
            told, own = float(self.mass[i, i]), self.inertia
            found["mass"] = {
                "told": told,
                "estimate": told * float(own.factor[i]),
                "error": told * float(own.factor_error[i]),
            }
            found["force"] = {
                "lag_s": float(own.lag[i]),
                "lag_error_s": float(own.lag_error[i]),
            }
        for name, against in (("acceleration", self.acceleration), ("velocity", self.velocity)):
            found[name] = against and {
                "scale": against.scale[i].tolist(),
                "scale_error": against.scale_error[i].tolist(),
                "lag_s": float(against.lag[i]),
                "lag_error_s": float(against.lag_error[i]),
            }
        return found


def calibration_check(
    record: Record, identified: IdentifiedMass | None = None
) -> CalibrationCheck | None:
    """Estimate mass, scales and lags of a test, and what they mean for it.

    Parameters
    ----------
    record : Record
        Of the test, without its ramp-down.
    identified : IdentifiedMass, optional
        Combined with the test's own estimate, by their standard errors.

    Returns
    -------
    CalibrationCheck or None
        None if the record does not describe the specimen, holds what is not finite or too few of
        the samples.
    """
    states, experiment = record.states, record.experiment
    assumed = _structure(experiment)
    if assumed is None or len(states.steps) < 2 or not np.isfinite(states.values).all():
        return None
    every = np.arange(states.steps[0], states.steps[-1] + 1)
    if len(states.steps) < (1.0 - MOST_LOST) * len(every):
        return None
    samples, dt = every_step(states, every), experiment.timebase.dt
    whole = whole_structure(assumed)
    mass = EquivalentMotion(whole, dt).mass
    frequency = motion_frequency(samples)
    if not frequency > 0:
        return CalibrationCheck(experiment.axes, mass, None, None, None, dict(_NOTHING), None)
    rig = experiment.sections.get("rig", {})
    x, v, a, _ = np.moveaxis(samples, 1, 0)
    of_acceleration = of_velocity = None
    expected = expected_relations(experiment, frequency)
    if expected is not None and rig.get("actuator.kind") not in FORCE_DRIVEN:
        of_acceleration = relation(a, x, 2, dt, frequency)
        if rig.get("sensors.velocity") != "derived":
            of_velocity = relation(v, x, 1, dt, frequency)
    springs = _springs(assumed, whole)
    own = _combined(inertia(samples, mass, springs, dt, frequency), identified)
    effect = _Effect(experiment, whole, samples, dt)
    errors, unsure = _errors(effect, own, [of_velocity, of_acceleration], expected)
    return CalibrationCheck(
        experiment.axes, mass, own, of_acceleration, of_velocity, errors, unsure
    )


_NOTHING: dict[str, float | None] = {"mass": None, "scale": None, "lag": None}


def _structure(experiment: Experiment, *factors: float) -> Experiment | None:
    """Give the assumed structure; with a computed model, the specimen alone."""
    assumed = assumed_structure(experiment, *factors)
    if assumed is None and "reference_force" in experiment.sections:
        section = experiment["reference_force"] | {"method": "eft", "mass_ratio": 0.0}
        alone = Experiment({**experiment.sections, "reference_force": section})
        return assumed_structure(alone, *factors)
    return assumed


def expected_relations(experiment: Experiment, frequency: float) -> tuple[Floats, Floats] | None:
    """Scale and lag that sound channels have because a command is held over a period.

    The ripple of held commands folds down to the frequency of the motion. In the acceleration it is
    0.1 % of it at 500 Hz and 0.8 % at 250 Hz with a valve of 70 Hz and an oil column of 90 Hz. It
    follows from the actuator that the test was told, on the specimen's model.

    Parameters
    ----------
    experiment : Experiment
        Of the test.
    frequency : float
        Of the motion, Hz.

    Returns
    -------
    scale, lag : ndarray
        Of velocity and acceleration against the displacement, shape (2, n), lags in s. None if no
        actuator is told.
    """
    nodes = ("reference_force", "force_controller")
    if any(node not in experiment.sections for node in nodes):
        return None
    told = Experiment({node: experiment[node] for node in nodes})
    try:
        rig = choose_rig(told)
        a, b, c = rig.sampled(experiment.timebase.dt, rig.plant.delay, 1.0)
    except (InputError, KeyError):
        return None
    n, s = len(experiment.axes), 2j * np.pi * frequency
    z = np.exp(s * experiment.timebase.dt)
    x, *others = np.split(c @ np.linalg.solve(z * np.eye(len(a)) - a, b), 4)
    ratios = np.array([np.diag(others[i]) / (s ** (i + 1) * np.diag(x)) for i in range(2)])
    return np.abs(ratios).reshape(2, n), -np.angle(ratios).reshape(2, n) / (2 * np.pi * frequency)


def _springs(assumed: Experiment, whole: WholeStructure) -> Floats:
    """Deformations of the specimen's springs per displacement, shape (p, n).

    Those of the model; without, springs between the axes that its stiffness couples, and to the
    ground where the stiffness does not add up to 0: of a shear frame its storeys.
    """
    section, axes = assumed["reference_force"], assumed.axes
    n = len(axes)
    if np.any(section.get("model.springs", 0.0)):
        return deformations(section["model.springs"], axes, "reference_force: model")
    stiffness = whole.structure.stiffness[:n, :n] - whole.computed.stiffness[:n, :n]
    least, one = _COUPLED * np.abs(stiffness).max(), np.eye(n)
    grounded = [one[i] for i in range(n) if abs(stiffness[i].sum()) > least]
    pairs = zip(*np.nonzero(np.abs(np.triu(stiffness, 1)) > least), strict=True)
    return np.array([*grounded, *(one[j] - one[i] for i, j in pairs)])


def _combined(own: Inertia | None, known: IdentifiedMass | None) -> Inertia | None:
    """Combine two estimates by their standard errors."""
    if known is None:
        return own
    if own is None:
        return Inertia(known.factor, known.factor_error, known.lag, known.lag_error)

    def mean(
        one: Floats, one_error: Floats, two: Floats, two_error: Floats
    ) -> tuple[Floats, Floats]:
        p, q = one_error**-2, two_error**-2
        return (p * one + q * two) / (p + q), (p + q) ** -0.5

    return Inertia(
        *mean(own.factor, own.factor_error, known.factor, known.factor_error),
        *mean(own.lag, own.lag_error, known.lag, known.lag_error),
    )


def _sure(value: Floats, error: Floats) -> Floats:
    """Give the deviations that are beyond chance, and 0 for the others."""
    return np.where(np.abs(value) > SIGMAS * error, value, 0.0)


def _errors(
    effect: "_Effect",
    own: Inertia | None,
    relations: list[Relation | None],
    expected: tuple[Floats, Floats] | None,
) -> tuple[dict[str, float | None], float | None]:
    """Find the displacement errors that deviations mean, and that of the mass's uncertainty."""
    found, unsure = dict(_NOTHING), None
    scales, lags = [], []
    if own is not None:
        factor = 1.0 + _sure(own.factor - 1.0, own.factor_error)
        found["mass"] = effect.of_mass(factor)
        unsure = effect.of_mass(1.0 + SIGMAS * own.factor_error)
        lags.append(effect.of_force_lag(_sure(own.lag, own.lag_error)))
    for i, one in enumerate(relations):
        if one is not None and expected is not None:
            scale, lag = np.diag(expected[0][i]), expected[1][i]
            off = _sure(one.scale - scale, one.scale_error)
            scales.append(effect.of_scale(np.eye(len(lag)) + off))
            lags.append(effect.of_lag(_sure(one.lag - lag, one.lag_error)))
    found["scale"] = max(scales, default=None)
    found["lag"] = max(lags, default=None)
    return found, unsure


class _Effect:
    """Displacement errors that deviations mean, over the displacement, RMS over all axes.

    They are the responses of linear structures to the change of the equivalent ground motion: with
    the model's stiffness, and with the smallest and the largest one of `stiffness_factors`.
    """

    def __init__(
        self, experiment: Experiment, whole: WholeStructure, samples: Floats, dt: float
    ) -> None:
        self._whole, self._samples, self._dt = whole, samples, dt
        self._motion = EquivalentMotion(whole, dt).advance(samples)
        n = samples.shape[2]
        self._mass = whole.structure.mass[:n, :n]
        self._own = EquivalentMotion(whole, dt).mass
        factors = stiffness_factors(whole, samples, self._own)
        damped = damping_factor(whole, samples, self._own)
        tried = (_structure(experiment, one, damped) for one in (factors[0], 1.0, factors[-1]))
        self._structures = [one for one in tried if one is not None]
        self._sizes = [self._response(one, self._motion) for one in self._structures]

    def _response(self, structure: Experiment, motion: Floats) -> float:
        return float(np.sqrt(np.mean(reference_response(structure, motion).displacement ** 2)))

    def _of(self, change: Floats) -> float:
        """Error for a change of the ground motion, shape (N, n), m/s^2."""
        if not change.any():
            return 0.0
        each = zip(self._structures, self._sizes, strict=True)
        return max(ratio(self._response(one, change), size) for one, size in each)

    def of_mass(self, factor: Floats) -> float:
        """Error if the mass is so many times the one told, or the force too large; shape (n,)."""
        if (factor == 1.0).all():
            return 0.0
        true = self._mass + (factor - 1.0)[:, np.newaxis] * self._own
        by_mass = self._motion @ np.linalg.solve(true, self._mass).T - self._motion
        return max(self._of(by_mass), self._of_force((1.0 / factor - 1.0) * self._samples[:, _F]))

    def of_force_lag(self, lag: Floats) -> float:
        """Error if the force is late by so much, shape (n,), s."""
        return self._of_force(led(self._samples[:, _F], lag, self._dt))

    def _of_force(self, change: Floats) -> float:
        if not change.any():
            return 0.0
        states = np.zeros_like(self._samples)
        states[:, _F] = change
        return self._of(EquivalentMotion(self._whole, self._dt).advance(states))

    def of_scale(self, scale: Floats) -> float:
        """Error if the displacement is wrong by such a scale and tilt, shape (n, n)."""
        true = np.linalg.inv(scale)
        return self._of(self._samples[:, _A] @ (true - np.eye(len(true))).T)

    def of_lag(self, lag: Floats) -> float:
        """Error if the displacement leads the acceleration by so much, shape (n,), s."""
        return self._of(led(self._samples[:, _A], lag, self._dt))


def led(y: Floats, lead: Floats, dt: float) -> Floats:
    """Give y(t + lead) - y(t) of signals of shape (N, n), leads of shape (n,) in s."""
    if not lead.any():
        return np.zeros_like(y)
    room = int(np.ceil(np.abs(lead).max() / dt)) + 64  # so that the ends do not meet
    size = next_fast_len(len(y) + room, real=True)
    w = 2j * np.pi * rfftfreq(size, dt)
    moved = irfft(rfft(y, size, axis=0) * np.exp(np.outer(w, lead)), size, axis=0)
    return moved[: len(y)] - y
