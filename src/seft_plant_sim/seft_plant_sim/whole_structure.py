"""The response that a perfect test would give: the whole structure, solved exactly."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.arrays import as_matrix
from seft_msgs_py.experiment import Experiment
from seft_msgs_py.parameters import group

from seft_plant_sim.computed_substructure import ComputedSubstructure
from seft_plant_sim.first_order_hold import first_order_hold
from seft_plant_sim.hysteretic_response import hysteretic_response
from seft_plant_sim.specimen import Specimen

Floats = npt.NDArray[np.float64]


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


def reference_response(experiment: Experiment, ground_motion: Floats) -> ReferenceResponse:
    """Exact response of the whole structure of an experiment (paper Eq. 2.1).

    M x'' + C x' + r(x) = -M a_g from rest. In a SEFT test it is the specimen and the computed
    substructure; in an EFT test M is (1 + mass_ratio) times the model's mass, all of it on the
    specimen (Eq. 2.2). Where the rig is simulated, the specimen is the simulated one; else it is
    the reference-force node's model.

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
    respond = hysteretic_response if specimen.springs else _linear_response
    displacement, velocity, elastic = respond(structure, motion, experiment.timebase.dt)
    restoring = elastic + velocity @ structure.damping.T
    acceleration = -motion - np.linalg.solve(structure.mass, restoring.T).T
    if section["method"] == "eft":
        force = -motion @ structure.mass.T
    else:
        own = restoring - displacement @ computed.stiffness.T - velocity @ computed.damping.T
        force = acceleration[:, :n] @ specimen.mass.T + own[:, :n]
    return ReferenceResponse(displacement[:, :n], velocity[:, :n], acceleration[:, :n], force)


@dataclass(frozen=True)
class WholeStructure:
    """Specimen and computed substructure together.

    Attributes
    ----------
    structure : Specimen
        Over n axes, then q internal degrees of freedom.
    computed : ComputedSubstructure
        The part that is computed; nothing in an EFT test.
    """

    structure: Specimen
    computed: ComputedSubstructure

    @classmethod
    def of_test(
        cls, specimen: Specimen, section: dict[str, Any], axes: Sequence[str]
    ) -> "WholeStructure":
        """Make that of a test with a reference force's section, see `reference_response`."""
        if section["method"] == "eft":
            model_mass = as_matrix(section["model.mass"], axes, "reference_force: model.mass")
            carried = replace(specimen, mass=(1.0 + section["mass_ratio"]) * model_mass)
            return cls(carried, ComputedSubstructure.none(len(axes)))
        return cls.of(specimen, ComputedSubstructure.from_parameters(section, axes))

    @classmethod
    def of(cls, specimen: Specimen, computed: ComputedSubstructure) -> "WholeStructure":
        """Put them together at the axes."""
        if computed.is_lumped:  # the very numbers of a structure that has no more than axes
            return cls(replace(specimen, mass=specimen.mass + computed.mass), computed)
        inside = [(0, computed.internal)] * 2
        return cls(
            replace(
                specimen,
                mass=np.pad(specimen.mass, inside) + computed.mass,
                damping=np.pad(specimen.damping, inside) + computed.damping,
                stiffness=np.pad(specimen.stiffness, inside) + computed.stiffness,
                deformation=np.pad(specimen.deformation, [(0, 0), inside[1]])
                if specimen.springs
                else specimen.deformation,
            ),
            computed,
        )

    def motion(self, ground_motion: Floats) -> Floats:
        """Ground acceleration of every degree of freedom, of that of the axes; (N, n + q)."""
        if not self.computed.internal:
            return ground_motion
        return np.hstack([ground_motion, ground_motion @ self.computed.influence.T])


def whole_structure(experiment: Experiment) -> WholeStructure:
    """Give specimen and computed substructure of an experiment, see `reference_response`.

    Raises
    ------
    InputError
        If there is no such structure.
    """
    return WholeStructure.of_test(
        tested_specimen(experiment), experiment["reference_force"], experiment.axes
    )


def tested_specimen(experiment: Experiment) -> Specimen:
    """Specimen of an experiment: the simulated one, else the reference-force node's model."""
    if "specimen.mass" in experiment.sections.get("rig", {}):
        source, where = group(experiment["rig"], "specimen"), "rig: specimen"
    else:
        source, where = group(experiment["reference_force"], "model"), "reference_force: model"
    return Specimen.from_parameters(source, experiment.axes, where)


def _linear_response(
    structure: Specimen, ground_motion: Floats, dt: float
) -> tuple[Floats, Floats, Floats]:
    """Displacement, velocity and force of the springs under ground motion, from rest.

    Exact where the motion is linear between samples.
    """
    n = structure.axes
    free, start, change = sampled_motion(structure, dt)
    states = np.zeros((len(ground_motion), 2 * n))
    states[1:] = ground_motion[:-1] @ start.T
    states[1:] += np.diff(ground_motion, axis=0) @ change.T
    _recur(free, states)
    displacement, velocity = states[:, :n], states[:, n:]
    return displacement, velocity, displacement @ structure.stiffness.T


def sampled_motion(structure: Specimen, dt: float) -> tuple[Floats, Floats, Floats]:
    """Take a linear structure's motion over one step, see `first_order_hold`.

    Returns
    -------
    free, start, change : ndarray
        Shapes (2n, 2n), (2n, n), (2n, n): the next (x, v) is free (x, v) + start a_g + change
        (next a_g - a_g).
    """
    a, b = structure.state_matrices()
    return first_order_hold(a, b @ -structure.mass, dt)


def _recur(free: Floats, states: Floats) -> None:
    """Solve s[k] = F s[k - 1] + d[k] for k from 1 on, in place of d; s[0] is given.

    A step of all pieces of a record at a time, twice: first from rest, for the states in which
    the pieces start, and then from these.
    """
    length = max(1, round(np.sqrt(len(states))))
    pieces = (len(states) - 1) // length
    driven = states[1 : 1 + pieces * length].reshape(pieces, length, len(free))
    ends = np.zeros((pieces, len(free)))
    for step in range(length):
        ends = ends @ free.T + driven[:, step]
    through = np.linalg.matrix_power(free, length)
    state, starts = states[0], np.empty_like(ends)
    for piece in range(pieces):
        starts[piece] = state
        state = through @ state + ends[piece]
    for step in range(length):
        starts = starts @ free.T + driven[:, step]
        driven[:, step] = starts
    for step in range(1 + pieces * length, len(states)):
        states[step] += free @ states[step - 1]
