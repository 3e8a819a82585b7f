"""Mass, scales and lags of a test from its own samples, against what the test knows.

The estimates are those of `seft_ros.analysis.channel_estimates` and
`seft_ros.analysis.mass_estimate`; `CalibrationEffect` says what a deviation means for the test.
"""

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import FORCE_DRIVEN
from seft_msgs_py.config.parameter_table import per_axis
from seft_plant_sim.calibration import SIGNIFICANT, significant
from seft_plant_sim.channels import ACCELERATION, FORCE
from seft_plant_sim.whole_structure import reference_response, whole_structure

from seft_ros.analysis import channel_estimates
from seft_ros.analysis.assessment import UNTOLD
from seft_ros.analysis.channel_estimates import Relation
from seft_ros.analysis.equivalent_motion import EquivalentMotion, assumed_structure
from seft_ros.analysis.mass_estimate import ALIKE_SPRINGS, inertia
from seft_ros.analysis.specimen_law import SpecimenLaw, fine_law, force_drift, springs_of
from seft_ros.bags.recording import Recording, every_step
from seft_ros.ground_motion.conditioning import moved_ahead
from seft_ros.ground_motion.ground_motion_block import GroundMotion


def calibration_structure(experiment: Experiment) -> Experiment | None:
    """Give the assumed structure; with a computed model, the specimen alone."""
    assumed = assumed_structure(experiment)
    if assumed is None and "reference_force" in experiment.sections:
        section = experiment["reference_force"] | {"method": "eft", "mass_ratio": 0.0}
        return assumed_structure(Experiment({**experiment.sections, "reference_force": section}))
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

    def laws(self) -> list[Floats]:
        """Give the regressors of the force of each spring, see `fine_law`."""
        return [
            fine_law(*one) for one in zip(self._law.deformation.T, self._law.noise, strict=True)
        ]

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
        more = (factor - 1.0)[:, np.newaxis] * self.mass
        by_mass = self._motion @ np.linalg.solve(self._total + more, -more).T
        by_force = (1.0 - 1.0 / factor) * self._samples[:, FORCE]
        return max(self._of(by_mass), self.of_zero(by_force))

    def of_force_scale(self, factor: Floats) -> float:
        """Error if force and mass are so many times too large, shape (n,): f / s and M_e / s."""
        off = 1.0 - 1.0 / factor
        force = self._motion @ self.mass.T + self._samples[:, FORCE]
        true = self._total - off[:, np.newaxis] * self.mass
        of_force = off * force @ np.linalg.inv(true).T
        if np.linalg.norm(of_force) < 1e-9 * np.linalg.norm(self._motion):  # EFT: rounding
            return 0.0
        return self._of(of_force)

    def of_force_lag(self, lag: Floats) -> float:
        """Error if the force is late by so much, shape (n,), s."""
        return self.of_zero(-led(self._samples[:, FORCE], lag, self._dt))

    def of_zero(self, force: Floats | float, acceleration: Floats | float = 0.0) -> float:
        """Error if the channels' zeros are off by so much, shape (N, n) or (n,), N and m/s^2."""
        states = np.zeros_like(self._samples)
        states[:, FORCE], states[:, ACCELERATION] = -force, -acceleration
        return self._of(EquivalentMotion(self._whole, self._dt).advance(states))

    def of_scale(self, scale: Floats) -> float:
        """Error if the displacement is wrong by such a scale and tilt, shape (n, n)."""
        true = np.linalg.inv(scale)
        return self._of(self._samples[:, ACCELERATION] @ (true - np.eye(len(true))).T)

    def of_lag(self, lag: Floats) -> float:
        """Error if the displacement leads the acceleration by so much, shape (n,), s."""
        return self._of(led(self._samples[:, ACCELERATION], lag, self._dt))


def effect_of_force(experiment: Experiment, factor: float) -> float | None:
    """Error of an experiment if its load cells show so many times the force, and told the mass.

    By the known linear specimen, over the displacement, RMS over all axes; None if not known.
    """
    structure = calibration_structure(experiment)
    if structure is None:
        return None
    dt, axes = experiment.timebase.dt, experiment.axes
    motion = GroundMotion(experiment["ground_motion"], axes, experiment.timebase)
    samples = reference_response(structure, motion.samples).states
    return CalibrationEffect(structure, samples, dt).of_force_scale(np.full(len(axes), factor))


def led(y: Floats, lead: Floats, dt: float) -> Floats:
    """Give y(t + lead) - y(t) of signals of shape (N, n), leads of shape (n,) in s."""
    return moved_ahead(y, lead, dt) - y if lead.any() else np.zeros_like(y)


CHANCE = 0.05
"""That errors of mass and channels mean more than ``at_most`` of `calibration_check`."""
ALIKE = 3.0
"""Standard errors within which an earlier estimate counts. Beyond, something may have changed, and
a better estimate of what was shall not hide that."""
MAX_LOST = 0.01
"""Share of samples that may be lost: they are interpolated, which is no measurement."""
MAX_SAMPLES = 1 << 16
"""Of a longer test the part that moves most counts, so that it takes a second and little memory."""

_AT_END = 0.01  # of the range, in which noise is
_FEWEST = 8  # samples of a half; noise is found in sixth differences
_KINDS = "mass", "scale", "lag", "drift"
_MEANS = "at_most", "clipped", "force_scale", "unsure", "unsure_lag"
_OfChannel = tuple[str, Relation, Floats, Floats]
"""A channel, its relation to the displacement, and the scale and lag expected, (n,)."""


@dataclass(frozen=True)
class Deviation:
    """An estimate against what it should be; of a channel and an axis.

    Attributes
    ----------
    effect : float
        Displacement error (RMS over RMS) that it means, with those of the other axes; 0 if all are
        within `SIGNIFICANT` standard errors.
    kind : str
        ``mass``, ``scale``, ``lag`` or ``drift``.
    channel, axis : str
        ``force`` (of a mass, too), ``acceleration`` or ``velocity``, and the axis.
    part_of : str
        Axis whose acceleration it is a part of; another one where an accelerometer is tilted.
    estimate, told, error : float
        Estimate, what it should be, and its standard error: kg, s, 1 for a scale, and N or m/s^2
        for a drift; of a force it is that of a spring, and how far its zero moved until the end.
    part : str
        Of the test: ``first half`` or ``second half``; empty: all of it.
    """

    effect: float
    kind: str
    channel: str
    axis: str
    part_of: str
    estimate: float
    told: float
    error: float
    part: str = ""


def calibration_check(recording: Recording) -> dict[str, Any] | None:
    """Estimate mass, scales and lags of a test, and what they mean for it.

    Parameters
    ----------
    recording : Recording
        Of the test, without its ramp-down. A mass that was identified before the test
        (``specimen.mass_error``) is combined with the test's own estimate, by their standard
        errors, unless they contradict each other.

    Returns
    -------
    dict or None
        JSON values; docs/metrics.md explains each. ``mass``, ``scale``, ``lag``, ``drift``: the
        worst `Deviation` of each kind; in a half of the test only what is beyond chance. ``axes``:
        axis -> ``mass``, ``force``, ``acceleration``, ``velocity``: all estimates. Displacement
        errors: ``at_most``, which mass, force, drift and acceleration together exceed with the
        chance `CHANCE`; ``clipped``, which accelerations beyond their sensor's range
        mean, by the velocity; ``force_scale``, which `UNTOLD` of the forces' scale would mean,
        where nobody told the scale, and the mass was identified by these forces; ``unsure`` and
        ``unsure_lag``, which `SIGNIFICANT` standard errors of the masses, and of the forces' lags,
        would mean. None: not known. All is None if the recording does not describe the specimen,
        holds what is not finite, or lacks too many samples.
    """
    states, experiment = recording.states, recording.experiment
    structure = calibration_structure(experiment)
    if structure is None or len(states.steps) < 2:
        return None
    every = np.arange(states.steps[0], states.steps[-1] + 1)
    whole = len(states.steps) >= (1.0 - MAX_LOST) * len(every)
    if not whole or not np.isfinite(states.values).all():
        return None
    samples, dt = strongest(every_step(states, every)), experiment.timebase.dt
    frequency, axes = channel_estimates.motion_frequency(samples), experiment.axes
    found, in_parts = list[Deviation](), list[Deviation]()
    means: dict[str, float | None] = dict.fromkeys(_MEANS)
    identified = _of_axes(experiment, "specimen.mass_error")
    untrue = _of_axes(experiment, "calibration.force_scale_error")
    if frequency > 0:
        effect = CalibrationEffect(structure, samples, dt)
        halves, laws = _halves(samples), effect.laws()
        of_test = samples, effect.mass, effect.springs, laws, dt, frequency
        own, *of_halves = inertia(*of_test, [*halves.values()])
        before = _known_inertia(experiment, effect.mass)
        # what deviates is told of masses that agree; what is not known, of the better estimate
        agreed, *of_halves = agreeing(own, of_halves)
        own, agreed = _combined(own, before), _combined(agreed, before)
        relations = list(_relations(experiment, samples, frequency))
        in_parts += _drifts(effect, laws, samples, dt, halves, axes)
        if own is not None:
            means["unsure"] = effect.of_mass(1.0 + SIGNIFICANT * own.scale_error)
            if np.isfinite(own.lag_error).all():
                means["unsure_lag"] = effect.of_force_lag(SIGNIFICANT * own.lag_error)
            moved = max((one.effect for one in in_parts), default=0.0)
            means["at_most"] = _at_most(effect, own, before, relations, untrue, moved)
        if identified.any() and not untrue.any():
            means["force_scale"] = effect.of_force_scale(np.full(len(axes), 1.0 + UNTOLD))
        if "acceleration_range" in recording.saturation:
            means["clipped"] = effect.of_zero(0.0, -_beyond_range(samples, dt))
        found += _deviations(effect, agreed, relations, axes)
        for (name, half), own in zip(halves.items(), of_halves, strict=True):
            relations = list(_relations(experiment, samples[half], frequency))
            for one in _deviations(effect.within(half), own, relations, axes):
                in_parts += [replace(one, part=name)] if one.effect else []
    # the worst has the largest effect, and without one the least likely estimate
    for_all = (*found, *in_parts)
    ranked = sorted(for_all, key=lambda one: (one.effect, abs(one.estimate - one.told) / one.error))
    worst = {one.kind: asdict(one) for one in ranked}
    numbers = {axis: _numbers(found, axis) for axis in axes}
    return {**dict.fromkeys(_KINDS), **worst, **means, "axes": numbers}


def _beyond_range(samples: Floats, dt: float) -> Floats:
    """Give what accelerations at the range's end lack, by the change of the velocity, (N, n)."""
    v, a = samples[:, 1], samples[:, 2]
    moved = (v[2:] - v[:-2]) / dt - 0.5 * (a[:-2] + a[2:]) - a[1:-1]
    is_at_end = np.abs(a[1:-1]) >= (1.0 - _AT_END) * np.abs(a).max()
    return np.pad(np.where(is_at_end & (moved * a[1:-1] > 0.0), moved, 0.0), [(1, 1), (0, 0)])


def _halves(samples: Floats) -> dict[str, slice]:
    """Part a test where half of the accelerations' energy is over: its end is almost at rest."""
    energy = np.cumsum((samples[:, 2] ** 2).sum(axis=1))
    middle = int(np.searchsorted(energy, 0.5 * energy[-1]))
    return {"first half": slice(0, middle), "second half": slice(middle, len(samples))}


def strongest(samples: Floats) -> Floats:
    """Cut the part of `MAX_SAMPLES` with the largest accelerations out of longer ones."""
    if len(samples) <= MAX_SAMPLES:
        return samples
    energy = np.cumsum(np.pad((samples[:, 2] ** 2).sum(axis=1), (1, 0)))
    begin = int(np.argmax(energy[MAX_SAMPLES:] - energy[:-MAX_SAMPLES]))
    return samples[begin : begin + MAX_SAMPLES]


def _numbers(found: list[Deviation], axis: str) -> dict[str, Any]:
    """All estimates of an axis, by channel and kind: estimate, known value and standard error."""
    numbers: dict[str, Any] = {}
    for one in found:
        if one.axis == axis:
            kind = one.kind if one.part_of == axis else f"{one.kind} of {one.part_of}"
            parts = {"estimate": one.estimate, "told": one.told, "error": one.error}
            numbers.setdefault(one.channel, {})[kind] = parts
    return numbers


_Numbers = tuple[Floats, Floats, Floats]


def _each(
    effect: float, kind: str, channel: str, axes: Sequence[str], numbers: _Numbers, part: str = ""
) -> Iterator[Deviation]:
    """Give an estimate, what it should be, and its error, of each axis or pair of axes with one."""
    estimate, told, error = (np.diag(one) if one.ndim == 1 else one for one in numbers)
    for i, j in zip(*np.nonzero(error), strict=True):
        own = float(estimate[i, j]), float(told[i, j]), float(error[i, j])
        yield Deviation(effect, kind, channel, axes[i], axes[j], *own, part)


def _deviations(
    effect: CalibrationEffect, own: Relation | None, others: list[_OfChannel], axes: Sequence[str]
) -> Iterator[Deviation]:
    none = np.zeros(len(axes))
    if own is not None:
        off, known = significant(own.scale - 1.0, own.scale_error), effect.mass.diagonal()
        masses = known * own.scale, known, known * own.scale_error
        yield from _each(effect.of_mass(1.0 + off), "mass", "force", axes, masses)
        late = effect.of_force_lag(significant(own.lag, own.lag_error))
        yield from _each(late, "lag", "force", axes, (own.lag, none, own.lag_error))
    for channel, of, scale, lag in others:
        wrong = significant(of.scale - np.diag(scale), of.scale_error)
        scales = of.scale, np.diag(scale), of.scale_error
        yield from _each(effect.of_scale(np.eye(len(axes)) + wrong), "scale", channel, axes, scales)
        late = effect.of_lag(significant(of.lag - lag, of.lag_error))
        yield from _each(late, "lag", channel, axes, (of.lag, lag, of.lag_error))


def _at_most(
    effect: CalibrationEffect,
    own: Relation,
    known: Relation | None,
    others: list[_OfChannel],
    untrue: Floats,
    moved: float,
) -> float:
    """Displacement error that the estimates' distribution exceeds with the chance `CHANCE`.

    The effects of mass, scale and lag are at other times: their squares add up. What is not known
    of the acceleration's scale is little but folding, which makes no test wrong, and a wrong
    velocity misleads the valve alone: the motion shows what came of it. What tells the mass tells
    the acceleration against the displacement as well, at least. No motion shows what is not known
    of the forces' scale, ``untrue``, (n,). ``moved`` is the effect of a drift.
    """
    off, lag_error = own.scale - 1.0, np.where(np.isfinite(own.lag_error), own.lag_error, 0.0)
    effects = [
        (effect.of_mass(1.0 + off), effect.of_mass(1.0 + own.scale_error)),
        (effect.of_force_lag(own.lag), effect.of_force_lag(lag_error)),
        (0.0, effect.of_force_scale(1.0 + untrue)),
        (moved, 0.0),
    ]
    for channel, of, scale, lag in others:
        if channel == "acceleration":
            own_scale, error = of.scale.diagonal(), of.scale_error.diagonal()
            here = Relation(1.0 + own_scale - scale, error, of.lag - lag, of.lag_error)
            both = _combined(here, known) or here
            shown = of.scale + np.diag(both.scale - own_scale)
            effects += (effect.of_scale(shown), 0.0), (effect.of_lag(both.lag), 0.0)
    mean, spread = np.array(effects).T
    drawn = mean + spread * np.random.default_rng(0).standard_normal((1 << 12, len(mean)))
    return float(np.quantile(np.sqrt((drawn**2).sum(axis=1)), 1.0 - CHANCE))


def _drifts(
    effect: CalibrationEffect,
    laws: list[Floats],
    samples: Floats,
    dt: float,
    halves: dict[str, slice],
    axes: tuple[str, ...],
) -> Iterator[Deviation]:
    """Zeros of acceleration and force that move; of the force where each spring has its own."""
    x, v, a, f = np.moveaxis(samples, 1, 0)
    n, springs, none = len(axes), effect.springs, np.zeros(len(axes))
    for name, half in halves.items():
        if half.stop - half.start < _FEWEST:
            return
        zero, error = channel_estimates.acceleration_zero(x[half], a[half], dt)
        of_zero = effect.within(half).of_zero(0.0, significant(zero, error))
        yield from _each(of_zero, "drift", "acceleration", axes, (zero, none, error), name)
    if len(springs) != n or np.linalg.cond(springs) > ALIKE_SPRINGS:
        return
    f, inertias = (y @ np.linalg.inv(springs) for y in (f, a @ effect.mass.T))
    others = np.stack([v @ springs.T, inertias], axis=2)
    every = zip(laws, others.swapaxes(0, 1), (f - inertias).T, strict=True)
    fits = [force_drift(*one) for one in every]
    moved, errors, shapes = (np.stack(each, axis=-1) for each in zip(*fits, strict=True))
    of_zero = effect.of_zero(significant(moved, errors) * shapes @ springs)
    yield from _each(of_zero, "drift", "force", axes, (moved, none, errors))


def _relations(experiment: Experiment, samples: Floats, frequency: float) -> Iterator[_OfChannel]:
    """Give each channel with its relation to the displacement, and the scale and lag expected.

    There are none if the relations of fault-free channels are not known: of an idealised actuator,
    whose force jumps from sample to sample, and where no actuator is known. A velocity that is
    derived from the displacement is no channel.
    """
    expected = channel_estimates.expected_relations(experiment, frequency)
    if expected is None or experiment["reference_force"]["actuator.kind"] in FORCE_DRIVEN:
        return
    x, v, a, _ = np.moveaxis(samples, 1, 0)
    dt, w = experiment.timebase.dt, 2 * np.pi * frequency
    derived = experiment["reference_force"]["sensors.velocity"] == "derived"
    channels = (1, "velocity", v), (2, "acceleration", a)
    for order, channel, y in channels[1:] if derived else channels:
        own, unsure = (each[order - 1] for each in expected)
        if (found := channel_estimates.relation(y, x, order, dt, frequency, unsure)) is not None:
            yield channel, found, np.abs(own), -np.angle(own) / w


def _known_inertia(experiment: Experiment, mass: Floats) -> Relation | None:
    """Give the known mass and lag with the errors that `seft identify` has found; None: with none.

    ``mass`` is the mass matrix that the test used, (n, n), kg.
    """
    error = _of_axes(experiment, "specimen.mass_error")
    late, none = _of_axes(experiment, "calibration.force_lag_error"), np.zeros_like(error)
    if not error.any():
        return None
    error = np.where(error > 0, error / np.diag(mass), np.inf)
    return Relation(none + 1.0, error, none, np.where(late > 0, late, np.inf))


def _of_axes(experiment: Experiment, name: str) -> Floats:
    """Give a parameter of the reference-force node for each axis, shape (n,)."""
    return per_axis(experiment["reference_force"][name], experiment.axes, f"/**: {name}")


def agreeing(whole: Relation | None, parts: list[Relation | None]) -> list[Relation | None]:
    """Widen the error of a test's mass by how far it is outside those of its parts.

    A few windows may agree by chance. Nor is the mass of a part known better than that of all.
    """
    masses = [part.scale for part in parts if part]
    if whole is None or not masses:
        return [whole, *parts]
    within = np.clip(whole.scale, np.min(masses, axis=0), np.max(masses, axis=0))
    least = np.hypot(whole.scale_error, whole.scale - within)
    every = (whole, *parts)
    return [one and replace(one, scale_error=np.maximum(one.scale_error, least)) for one in every]


def _combined(own: Relation | None, known: Relation | None) -> Relation | None:
    """Combine two estimates by their standard errors.

    Where they contradict each other something has changed after the mass was identified: then the
    test's own estimate stands alone.
    """
    if own is None or known is None:
        return own or known

    def mean(a: Floats, of_a: Floats, b: Floats, of_b: Floats) -> tuple[Floats, Floats]:
        alike = np.abs(a - b) <= ALIKE * np.hypot(of_a, of_b)
        p, q = of_a**-2, of_b**-2
        both, error = (p * a + q * b) / (p + q), (p + q) ** -0.5
        return np.where(alike, both, a), np.where(alike, error, of_a)

    return Relation(
        *mean(own.scale, own.scale_error, known.scale, known.scale_error),
        *mean(own.lag, own.lag_error, known.lag, known.lag_error),
    )
