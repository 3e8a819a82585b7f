"""The response that a perfect test would give: the whole structure, solved exactly."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.config.arrays import as_matrix
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.parameter_table import group

from seft_plant_sim.reference.computed_substructure import ComputedSubstructure
from seft_plant_sim.reference.response import ShakenStructure, response
from seft_plant_sim.specimen.specimen import Specimen

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
    x, v, a, r = response(structure, motion, experiment.timebase.dt)
    if section["method"] == "eft":
        force = -motion @ structure.mass.T
    else:
        # f = M_e a + C v + r(x) of the specimen alone
        own = r - x @ computed.stiffness.T + v @ (structure.damping - computed.damping).T
        force = a[:, :n] @ specimen.mass.T + own[:, :n]
    return ReferenceResponse(x[:, :n], v[:, :n], a[:, :n], force)


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
