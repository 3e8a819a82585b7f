"""The response that a perfect test would give: the whole structure, solved exactly."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm
from seft_msgs_py.arrays import as_matrix
from seft_msgs_py.experiment import Experiment
from seft_msgs_py.parameters import group

from seft_plant_sim.specimen import LinearSpecimen

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

    M x'' + C x' + K x = -M a_g from rest. In a SEFT test M is the specimen's mass and the
    computed mass, mass_ratio times the model's; in an EFT test M is (1 + mass_ratio) times
    the model's mass, all of it on the specimen (Eq. 2.2). Where the rig is simulated, the
    specimen is the simulated one; else it is the reference-force node's model.

    Parameters
    ----------
    experiment : Experiment
        Resolved parameters.
    ground_motion : ndarray
        Ground acceleration of each axis by step, shape (N, n), m/s^2; linear in between.
    """
    section = experiment["reference_force"]
    model = group(section, "model")
    axes = experiment.axes
    if "specimen.mass" in experiment.sections.get("rig", {}):
        source, where = group(experiment["rig"], "specimen"), "rig: specimen"
    else:
        source, where = model, "reference_force: model"
    specimen = LinearSpecimen.from_parameters(source, axes, where)
    model_mass = as_matrix(model["mass"], axes, "reference_force: model.mass")
    if section["method"] == "eft":
        mass = (1.0 + section["mass_ratio"]) * model_mass
    else:
        mass = specimen.mass + section["mass_ratio"] * model_mass
    whole = LinearSpecimen(mass, specimen.damping, specimen.stiffness)
    displacement, velocity = _respond(whole, ground_motion, experiment.timebase.dt)
    restoring = displacement @ specimen.stiffness.T + velocity @ specimen.damping.T
    acceleration = -ground_motion - np.linalg.solve(mass, restoring.T).T
    if section["method"] == "eft":
        force = -ground_motion @ mass.T
    else:
        force = acceleration @ specimen.mass.T + restoring
    return ReferenceResponse(displacement, velocity, acceleration, force)


def _respond(structure: LinearSpecimen, ground_motion: Floats, dt: float) -> tuple[Floats, Floats]:
    """Displacement and velocity under ground motion, from rest.

    Exact where the motion is linear between samples (first-order hold, Van Loan 1978).
    """
    n = structure.axes
    a, b = structure.state_matrices()
    augmented = np.zeros((4 * n, 4 * n))
    augmented[: 2 * n, : 2 * n] = a * dt
    augmented[: 2 * n, 2 * n : 3 * n] = b @ -structure.mass * dt
    augmented[2 * n : 3 * n, 3 * n :] = np.eye(n)
    exponential = expm(augmented)
    free = np.ascontiguousarray(exponential[: 2 * n, : 2 * n])
    start, change = exponential[: 2 * n, 2 * n : 3 * n], exponential[: 2 * n, 3 * n :]
    drive = ground_motion[:-1] @ start.T + np.diff(ground_motion, axis=0) @ change.T
    states = np.zeros((len(ground_motion), 2 * n))
    for step in range(len(drive)):
        states[step + 1] = free.dot(states[step]) + drive[step]
    return states[:, :n], states[:, n:]
