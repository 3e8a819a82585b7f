"""The response of a perfect test: the whole structure from rest, solved exactly.

For a nonlinear structure the response is accurate to the integration's tolerance.
"""

import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.parameter_table import group

from seft_plant_sim.compiled import compiled, multiply
from seft_plant_sim.computed.computed_model import ComputedModel, ModelSource
from seft_plant_sim.computed.computed_substructure import ComputedSubstructure
from seft_plant_sim.rig_parameters import SIMULATED
from seft_plant_sim.simulated import continuous_model
from seft_plant_sim.simulated.continuous_model import ContinuousModel, Dynamics, Motion, integrate
from seft_plant_sim.simulated.specimen import Specimen

_TOLERANCE = 1e-5
"""Of displacement and velocity, relative to their peaks."""
_COARSEST = 4
_FINEST = 1 << 14
"""Steps of the integration within one of the response."""
MODEL_TOLERANCE = 5e-3
"""The same for a structure with a computed model, whose steps may take long: the error is of second
order in the step, so that extrapolation of two responses reduces it to a twentieth."""
COARSEST_MODEL, FINEST_MODEL = 1, 64
"""Its steps."""


def response(
    structure: Specimen, ground_motion: Floats, dt: float, model: ModelSource | None = None
) -> Floats:
    """Response to a ground motion that is linear between its samples.

    It is exact if the structure is linear. Otherwise the steps of the integration are halved until
    the response changes by less than `_TOLERANCE`, or `MODEL_TOLERANCE`; the error is then about a
    quarter of that.

    Parameters
    ----------
    structure : Specimen
        Of n degrees of freedom; its mass is the whole structure's.
    ground_motion : ndarray
        Ground acceleration of each, shape (N, n), m/s^2.
    dt : float
        Period of a step, s.
    model : ModelSource, optional
        Acts in addition to it, see `ComputedSubstructure`.

    Returns
    -------
    ndarray
        Relative displacement (m), velocity (m/s), acceleration (m/s^2) and force of the springs
        (N, without damping), shape (4, N, n).
    """
    if not structure.springs and model is None:
        return ShakenStructure(structure, dt, 1).advance(ground_motion)

    def integrated(steps: int) -> Floats:
        if model is None:
            return ShakenStructure(structure, dt, steps).advance(ground_motion)
        with closing(ModelledStructure(structure, dt, steps, model)) as modelled:
            return modelled.advance(ground_motion)

    steps, finest, tolerance = _COARSEST, _FINEST, _TOLERANCE
    if model is not None:
        steps, finest, tolerance = COARSEST_MODEL, FINEST_MODEL, MODEL_TOLERANCE
    coarse = integrated(steps)
    while True:
        steps *= 2
        fine = integrated(steps)
        change, peak = (np.abs(y[:2]).max(axis=(1, 2)) for y in (fine - coarse, fine))
        if (change <= tolerance * peak).all() or steps == finest:
            break
        coarse = fine
    return fine if model is None else fine + (fine - coarse) / 3.0


class ShakenStructure:
    """A structure of n degrees of freedom whose ground motion becomes known step by step.

    A step of ``dt`` s is integrated in ``steps``; one is exact if the structure is linear.
    """

    def __init__(self, structure: Specimen, dt: float, steps: int) -> None:
        self._structure, self._dt = structure, dt
        self._dynamics = continuous_model.dynamics_of(_shaken(structure), [dt], dt / steps)
        self._motion = continuous_model.at_rest(self._dynamics)
        self._last: Floats | None = None

    def advance(self, ground_motion: Floats) -> Floats:
        """Continue over the next N steps; the first of all is step 0, at rest.

        The ground motion has shape (N, n), N at least 1, m/s^2; the result is that of `response`.
        """
        motion = np.array(ground_motion, dtype=np.float64, order="C")
        last = motion[0] if self._last is None else self._last
        samples = np.empty((len(motion), 4 * motion.shape[1]))
        _respond(self._dynamics, self._motion, self._dt, last, motion, samples, self._last is None)
        for spring in self._structure.springs:
            spring.check()
        self._last = motion[-1]
        return np.moveaxis(samples.reshape(len(motion), 4, -1), 1, 0)

    def correct(self, acceleration: Floats, velocity: Floats) -> None:
        """Add to the present ground acceleration and to the velocity; shape (n,) each."""
        n = self._structure.axes
        self._motion.work[n : 2 * n] += velocity
        if self._last is not None:
            self._last = self._last + acceleration


class ModelledStructure:
    """A `ShakenStructure` with a computed model, which takes the same steps.

    The model's force minus that of its tangents acts like ground acceleration. Over a step it is
    extrapolated, and then corrected, so that the impulse is that of the trapezoidal rule.
    """

    def __init__(self, structure: Specimen, dt: float, steps: int, model: ModelSource) -> None:
        inner = _COARSEST if structure.springs else 1
        self._step, self._steps = dt / steps, steps
        self._shaken = ShakenStructure(structure, self._step, inner)
        self._inverse = np.linalg.inv(structure.mass)
        self._tangents, self._model = model.tangents, ComputedModel(model)
        self._model.start(self._step)
        self._last: Floats | None = None
        self._acts, self._rises = np.zeros((2, structure.axes))  # m/s^2, and m/s^2 in a step
        self._count = 0
        self.times: list[float] = []  # s, durations of the model's steps

    def advance(self, ground_motion: Floats) -> Floats:
        """Continue over the next N steps, see `ShakenStructure.advance`."""
        samples = np.empty((4, *ground_motion.shape))
        for k, ground in enumerate(ground_motion):
            last, steps = (ground, 1) if self._last is None else (self._last, self._steps)
            for step in range(1, steps + 1):
                samples[:, k] = self._advance(last + step / steps * (ground - last))
            self._last = ground
        return samples

    def close(self) -> None:
        """End the model."""
        self._model.close()

    def _advance(self, ground: Floats) -> Floats:
        expected = self._acts + self._rises
        sample = self._shaken.advance((ground + expected)[np.newaxis])[:, 0]
        x, v, a, _ = sample
        stiffness, damping = self._tangents
        begun = time.perf_counter()
        force = self._model.step(self._step * self._count, x, v, ground).force
        self.times.append(time.perf_counter() - begun)
        acts = self._inverse @ (force - stiffness @ x - damping @ v)
        missed = acts - expected
        impulse = np.zeros_like(missed) if self._count == 0 else -0.5 * self._step * missed
        self._shaken.correct(missed, impulse)
        v += impulse
        a -= missed
        self._rises = acts - self._acts if self._count else np.zeros_like(acts)
        self._acts, self._count = acts, self._count + 1
        return sample


@partial(compiled, nogil=True)
def _respond(
    dynamics: Dynamics,
    motion: Motion,
    dt: float,
    last: Floats,
    ground_motion: Floats,
    samples: Floats,
    from_rest: bool,
) -> None:
    """Take a structure through the samples of a ground motion that follow the last one."""
    n = len(last)
    for k in range(len(ground_motion)):
        for i in range(n):
            before = last[i] if k == 0 else ground_motion[k - 1, i]
            motion.work[2 * n + i] = before
            motion.work[3 * n + i] = (ground_motion[k, i] - before) / dt
        if k or not from_rest:
            integrate(dynamics, 0, motion)
        multiply(dynamics.output, motion.work, samples[k])


def _shaken(structure: Specimen) -> ContinuousModel:
    """Model of a structure with states x, v, a_g, driven by the slope of the ground motion.

    M x'' + C x' + r(x) = -M a_g; the outputs are x, x', x'' and r(x).
    """
    n = structure.axes
    zero, one = np.zeros((n, n)), np.eye(n)
    moving, _ = structure.state_matrices()
    a = np.block([[moving, np.vstack([zero, -one])], [zero, zero, zero]])
    b = np.vstack([zero, zero, one])
    stiffness = np.hstack([structure.stiffness, zero, zero])
    c = np.vstack([np.eye(2 * n, 3 * n), a[n : 2 * n], stiffness])
    linear = ContinuousModel.linear(a, b, c, np.zeros((4 * n, n)), 0.0, "reference_force")
    model = continuous_model.with_springs(linear, structure)
    if structure.springs:
        model.outputs[3 * n :] = structure.deformation.T
    return model


@dataclass(frozen=True)
class ReferenceResponse:
    """Exact response of the whole structure, by step.

    Attributes
    ----------
    displacement, velocity, acceleration : ndarray
        Relative to the ground, shape (N, n), in m, m/s, m/s^2.
    force : ndarray
        Force that the actuators of a perfect test apply, shape (N, n), N.
    """

    displacement: Floats
    velocity: Floats
    acceleration: Floats
    force: Floats

    @property
    def states(self) -> Floats:
        """States of a perfect test: all four, shape (N, 4, n)."""
        return np.stack([*vars(self).values()], axis=1)

    def first(self, count: int) -> "ReferenceResponse":
        """Give the first steps."""
        return ReferenceResponse(*(part[:count] for part in vars(self).values()))


def reference_response(experiment: Experiment, ground_motion: Floats) -> ReferenceResponse:
    """Exact response of the whole structure of an experiment (paper Eq. 2.1).

    M x'' + C x' + r(x) = -M a_g from rest. In a SEFT test it is the specimen and the computed
    substructure; in an EFT test it is the specimen alone (Eq. 2.2). The specimen is that of the
    simulated rig; without one it is the known one.

    Parameters
    ----------
    experiment : Experiment
        Resolved parameters.
    ground_motion : ndarray
        Ground acceleration of each axis by step, shape (N, n), m/s^2; linear in between.
    """
    section = experiment["reference_force"]
    specimen = tested_specimen(experiment)
    n, whole = specimen.axes, WholeStructure.of_test(specimen, section, experiment.axes)
    structure, computed = whole.structure, whole.computed
    motion = whole.motion(ground_motion)
    x, v, a, r = response(structure, motion, experiment.timebase.dt, computed.model)
    if section["method"] == "eft":
        force = -motion @ structure.mass.T
    else:
        # f = M_e a + C v + r(x) of the specimen alone
        own = r - x @ computed.stiffness.T + v @ (structure.damping - computed.damping).T
        force = a[:, :n] @ specimen.mass.T + own[:, :n]
    return ReferenceResponse(x[:, :n], v[:, :n], a[:, :n], force)


def model_times(whole: "WholeStructure", ground_motion: Floats, dt: float) -> list[float]:
    """Measure the steps of ``dt`` s of a computed model along the motion of its structure, s.

    The ground acceleration of the axes has shape (N, n), m/s^2.
    """
    assert whole.computed.model is not None
    modelled = ModelledStructure(whole.structure, dt, 1, whole.computed.model)
    with closing(modelled):
        modelled.advance(whole.motion(ground_motion))
    return modelled.times


@dataclass(frozen=True)
class WholeStructure:
    """Specimen and computed substructure together.

    Attributes
    ----------
    structure : Specimen
        Over n axes, then q internal degrees of freedom.
    computed : ComputedSubstructure
        The computed part; empty in an EFT test.
    """

    structure: Specimen
    computed: ComputedSubstructure

    @classmethod
    def of_test(
        cls, specimen: Specimen, section: dict[str, Any], axes: Sequence[str]
    ) -> "WholeStructure":
        """Make that of a test from the section of reference_force, see `reference_response`."""
        if section["method"] == "eft":
            return cls(specimen, ComputedSubstructure.lumped(np.zeros_like(specimen.mass)))
        computed = ComputedSubstructure.from_parameters(section, axes)
        inside = [(0, computed.internal)] * 2
        structure = replace(
            specimen,
            mass=np.pad(specimen.mass, inside) + computed.mass,
            damping=np.pad(specimen.damping, inside) + computed.damping,
            stiffness=np.pad(specimen.stiffness, inside) + computed.stiffness,
            deformation=np.pad(specimen.deformation, [(0, 0), inside[1]]),
        )
        return cls(structure, computed)

    def motion(self, ground_motion: Floats) -> Floats:
        """Ground acceleration of every degree of freedom from that of the axes; (N, n + q)."""
        if not self.computed.internal:
            return ground_motion
        if self.computed.on_axes is not None:
            return ground_motion @ self.computed.by_axis.T
        return np.hstack([ground_motion, ground_motion @ self.computed.influence.T])


def whole_structure(experiment: Experiment) -> WholeStructure:
    """Give specimen and computed substructure of an experiment, see `reference_response`.

    Raises
    ------
    InputError
        If the parameters make no such structure.
    """
    specimen, section = tested_specimen(experiment), experiment["reference_force"]
    return WholeStructure.of_test(specimen, section, experiment.axes)


def tested_specimen(experiment: Experiment) -> Specimen:
    """Specimen of an experiment: the simulated one, else the known one."""
    if is_simulated(experiment):
        source, where = group(experiment["rig"], "simulated.specimen"), "rig: simulated.specimen"
    else:
        source, where = group(experiment["reference_force"], "specimen"), "/**: specimen"
    return Specimen.from_parameters(source, experiment.axes, where)


def is_simulated(experiment: Experiment) -> bool:
    """Whether an experiment has a simulated rig."""
    rig = experiment.sections.get("rig", {})
    return "simulated.specimen.mass" in rig and rig.get("hardware", SIMULATED) == SIMULATED


_STEPS = 16
"""Of the integration within a step of a nonlinear structure: accurate enough for a plot."""


class RunningResponse:
    """Response of the whole structure of an experiment as its ground motion becomes known.

    It is exact if the structure is linear.
    """

    def __init__(self, experiment: Experiment) -> None:
        self._whole = whole_structure(experiment)
        structure, model = self._whole.structure, self._whole.computed.model
        self.exact = not structure.springs and model is None
        dt = experiment.timebase.dt
        self._shaken: ShakenStructure | ModelledStructure
        if model is None:
            self._shaken = ShakenStructure(structure, dt, 1 if self.exact else _STEPS)
        else:
            self._shaken = ModelledStructure(structure, dt, COARSEST_MODEL, model)

    def advance(self, ground_motion: Floats) -> tuple[Floats, Floats]:
        """Continue over the next N steps of the ground motion, shape (N, n), m/s^2, N at least 1.

        The first of all is step 0, at rest. Gives displacement and acceleration relative to the
        ground, shape (N, n), m and m/s^2.
        """
        n = ground_motion.shape[1]
        x, _, a, _ = self._shaken.advance(self._whole.motion(ground_motion))
        return x[:, :n], a[:, :n]
