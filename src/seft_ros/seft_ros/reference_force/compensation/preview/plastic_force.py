"""Restoring force of a specimen that yields: its tangent, and what it will do next."""

import numpy as np
import numpy.typing as npt

from seft_ros.reference_force.compensation.preview.tangent_filter import TangentFilter
from seft_ros.reference_force.compensation.preview.target_prediction import Gains

Floats = npt.NDArray[np.float64]

_SOFTEST = -0.97  # slope over stiffness at which softening is expected to end


class PlasticForce:
    """Tangent of the restoring force of n springs between n axes, beside an elastic model.

    With the springs' deformations e = D x, p = r - K x - C v = D^T s, and each s is followed
    with its slope kappa = ds/de (`TangentFilter`); the tangent stiffness is K + D^T kappa D. While
    a spring softens, kappa is expected to go on changing over the way as it does now, until
    hardly any stiffness is left.

    Parameters
    ----------
    stiffness : ndarray
        K, elastic, shape (n, n), N/m.
    noise : ndarray
        Covariance of what noise makes of r - (K x + C v), shape (n, n), N^2.
    displacements : Gains
        Of the coming displacements, as `TargetPrediction.displacements` gives them.
    deformation : ndarray
        D, shape (n, n), invertible.

    Attributes
    ----------
    slope : ndarray
        D^T kappa D, shape (n, n), N/m.
    """

    def __init__(
        self,
        stiffness: Floats,
        noise: Floats,
        displacements: Gains,
        deformation: Floats,
    ) -> None:
        n = len(stiffness)
        self._deformation, self._back = deformation, np.linalg.inv(deformation)
        own = np.diag(self._back.T @ stiffness @ self._back)
        shared = np.diag(self._back.T @ noise @ self._back)
        pairs = zip(own.tolist(), shared.tolist(), strict=True)
        self._filters = [TangentFilter(*pair) for pair in pairs]
        self._bounds = [(_SOFTEST * k, -1e-9 * k) for k in own.tolist()]
        self._ways = np.hstack(displacements)
        self._ways[:, :n] -= np.tile(np.eye(n), (len(self._ways) // n, 1))
        self._known = np.zeros(self._ways.shape[1])
        places = np.cumsum([part.shape[1] for part in displacements[:-1]])
        parts = np.split(self._known, places)
        self._motion, self._ground_motion, self._flat_forces, self._committed = parts
        self._forces = self._flat_forces.reshape(-1, n)  # p on the way
        self._begun = False
        self.slope = np.zeros((n, n))
        # of the way ahead: its direction, slope and bend on it, and where the bend ends
        self._direction, self._slope, self._bend, self._end = np.zeros((4, n))
        self._tangent = np.zeros(n)
        self._softens = False

    def update(self, motion: Floats, rest: Floats, residual: Floats) -> None:
        """Take a sample in: p is corrected in place.

        Parameters
        ----------
        motion : ndarray
            Displacement and velocity, shape (2n,).
        rest : ndarray
            p, shape (n,), N.
        residual : ndarray
            p as measured, shape (n,), N.
        """
        forces = np.stack([rest, residual]) @ self._back  # of the springs
        samples = zip(
            *(motion.reshape(2, -1) @ self._deformation.T).tolist(), *forces.tolist(), strict=True
        )
        of_springs = zip(self._filters, self._bounds, samples, strict=True)
        self._softens = False
        for spring, (own, (lowest, straight), sample) in enumerate(of_springs):
            forces[0, spring] = own.step(*sample)
            slope = self._tangent[spring] = own.slope
            direction = -1.0 if sample[1] < 0.0 else 1.0
            bend = own.bend * direction
            if bend < straight:
                self._softens = True
            else:  # only softening is expected to go on
                bend = straight
            self._direction[spring], self._slope[spring] = direction, slope * direction
            self._bend[spring] = bend * direction
            self._end[spring] = min(lowest - slope, 0.0) / bend
        rest[:] = forces[0] @ self._deformation
        self.slope = (self._deformation.T * self._tangent) @ self._deformation

    def coming(
        self, motion: Floats, rest: Floats, ground_motion: Floats, committed: Floats
    ) -> Floats:
        """Predict p over the horizon, shape ((1 + horizon) n,), N; valid until the next call.

        Beyond the point where the specimen turns it stays as it was there. The way depends on
        the forces and they on the way: those of the step before are the guess.
        """
        n = len(rest)
        self._motion[:] = motion
        self._ground_motion[:] = ground_motion.reshape(-1)
        self._committed[:] = committed.reshape(-1)
        forces = self._forces
        if self._begun:
            forces[:-1] = forces[1:]
        else:
            forces[:] = rest
            self._begun = True
        way = self._ways.dot(self._known).reshape(-1, n) @ self._deformation.T
        way *= self._direction
        np.maximum.accumulate(way, out=way)
        of_springs = way * self._slope
        if self._softens:
            bent = np.minimum(way, self._end)
            way -= 0.5 * bent
            way *= bent
            way *= self._bend
            of_springs += way
        np.dot(of_springs, self._deformation, out=forces)
        forces += rest
        return self._flat_forces
