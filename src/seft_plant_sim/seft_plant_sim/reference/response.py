"""Response of a structure to ground motion from rest: exact, or as near as one likes."""

from functools import partial

import numpy as np
import numpy.typing as npt

from seft_plant_sim.compiled import compiled
from seft_plant_sim.continuous_model import ContinuousModel, with_springs
from seft_plant_sim.integration import Dynamics, Motion, at_rest, dynamics_of, integrate, multiply
from seft_plant_sim.specimen.specimen import Specimen

Floats = npt.NDArray[np.float64]

TOLERANCE = 1e-5
"""Of displacement and velocity, relative to their peaks."""
COARSEST = 4
FINEST = 1 << 14
"""Steps of the integration within one of the response."""


def response(structure: Specimen, ground_motion: Floats, dt: float) -> Floats:
    """Response to a ground motion that is linear between its samples.

    Exact where the structure is linear. Else the steps of the integration are halved until the
    response changes by less than `TOLERANCE`; it then is some four times as near.

    Parameters
    ----------
    structure : Specimen
        Of n degrees of freedom; its mass is the whole structure's.
    ground_motion : ndarray
        Ground acceleration of each, shape (N, n), m/s^2.
    dt : float
        Period of a step, s.

    Returns
    -------
    ndarray
        Relative displacement (m), velocity (m/s), acceleration (m/s^2) and force of the springs
        (N, without damping), shape (4, N, n).
    """
    if not structure.springs:
        return ShakenStructure(structure, dt, 1).advance(ground_motion)
    steps = COARSEST
    coarse = ShakenStructure(structure, dt, steps).advance(ground_motion)
    while steps < FINEST:
        steps *= 2
        fine = ShakenStructure(structure, dt, steps).advance(ground_motion)
        change, peak = (np.abs(y[:2]).max(axis=(1, 2)) for y in (fine - coarse, fine))
        if (change <= TOLERANCE * peak).all():
            break
        coarse = fine
    return fine


class ShakenStructure:
    """A structure whose ground motion becomes known by and by.

    Parameters
    ----------
    structure : Specimen
        Of n degrees of freedom.
    dt : float
        Period of a step, s.
    steps : int
        Steps of the integration within one; one is exact where the structure is linear.
    """

    def __init__(self, structure: Specimen, dt: float, steps: int) -> None:
        self._structure, self._dt = structure, dt
        self._dynamics = dynamics_of(_shaken(structure), 0.0, dt, dt / steps)
        self._motion = at_rest(self._dynamics)
        self._last: Floats | None = None

    def advance(self, ground_motion: Floats) -> Floats:
        """Go on over the next N steps; the first of all is step 0, at rest.

        Parameters
        ----------
        ground_motion : ndarray
            Shape (N, n), N at least 1, m/s^2.

        Returns
        -------
        ndarray
            As `response`, shape (4, N, n).
        """
        motion = np.array(ground_motion, dtype=np.float64, order="C")
        last = motion[0] if self._last is None else self._last
        samples = np.empty((len(motion), 4 * motion.shape[1]))
        _respond(self._dynamics, self._motion, self._dt, last, motion, samples, self._last is None)
        for spring in self._structure.springs:
            spring.check()
        self._last = motion[-1]
        return np.moveaxis(samples.reshape(len(motion), 4, -1), 1, 0)


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
            integrate(dynamics, 1, motion)
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
    model = with_springs(linear, structure)
    if structure.springs:
        model.outputs[3 * n :] = structure.deformation.T
    return model
