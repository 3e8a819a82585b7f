"""Restoring force of a specimen that yields: its tangent, and what it will do next."""

import numpy as np
import numpy.typing as npt

from seft_ros.reference_force.compensation.preview.tangent_filter import TangentFilter

Floats = npt.NDArray[np.float64]

_SOFTEST = -0.97  # slope over stiffness at which softening is expected to end
_PASSES = 2  # of the coming displacements and the forces that depend on them


class PlasticForce:
    """Tangent of the restoring force on each of n axes, beside an elastic model.

    p = r - K x - C v is followed with its slope kappa = dp/dx (`TangentFilter`); the tangent
    stiffness is K + kappa. While the specimen softens, kappa is expected to go on changing over
    the way as it does now, until hardly any stiffness is left.

    Parameters
    ----------
    stiffness : ndarray
        Elastic stiffness of each axis, shape (n,), N/m.
    noise : ndarray
        Variance of the measured restoring force, shape (n,), N^2.
    displacements : tuple of ndarray
        Gains of the coming displacements, as `TargetPrediction.displacements` gives them.
    """

    def __init__(
        self, stiffness: Floats, noise: Floats, displacements: tuple[Floats, Floats, Floats]
    ) -> None:
        n = len(stiffness)
        pairs = zip(stiffness.tolist(), noise.tolist(), strict=True)
        self._filters = [TangentFilter(*pair) for pair in pairs]
        self._lowest, self._straight = _SOFTEST * stiffness, -1e-9 * stiffness
        from_motion, from_ground_motion, self._from_rest = displacements
        self._from_known = np.hstack([from_motion, from_ground_motion])
        self._known = np.zeros(self._from_known.shape[1])
        self._forces = np.zeros((len(from_motion) // n, n))
        self.slope, self._bend = np.zeros((2, n))

    def update(self, motion: Floats, rest: Floats, residual: Floats) -> None:
        """Take a sample in: p is corrected in place.

        Parameters
        ----------
        motion : ndarray
            Displacement and velocity, shape (2, n).
        rest : ndarray
            p, shape (n,), N.
        residual : ndarray
            p as measured, shape (n,), N.
        """
        samples = zip(*motion.tolist(), rest.tolist(), residual.tolist(), strict=True)
        for axis, (own, sample) in enumerate(zip(self._filters, samples, strict=True)):
            rest[axis] = own.step(*sample)
            self.slope[axis], self._bend[axis] = own.slope, own.bend

    def coming(self, motion: Floats, rest: Floats, ground_motion: Floats) -> Floats:
        """Predict p over the horizon, shape ((1 + horizon) n,), N.

        Beyond the point where the specimen turns it stays as it was there.
        """
        n = len(rest)
        self._known[: 2 * n] = motion.reshape(-1)
        self._known[2 * n :] = ground_motion.reshape(-1)
        direction = np.where(motion[1] < 0.0, -1.0, 1.0)
        elastic = self._from_known.dot(self._known).reshape(-1, n)
        elastic -= motion[0]
        # only softening is expected to go on
        bend = np.minimum(self._bend * direction, self._straight)
        end = np.minimum(self._lowest - self.slope, 0.0) / bend
        slope, bend = self.slope * direction, bend * direction
        forces = self._forces
        forces[:] = rest
        for _ in range(_PASSES):
            way = elastic + self._from_rest.dot(forces.reshape(-1)).reshape(-1, n)
            way *= direction
            np.maximum.accumulate(way, out=way)
            bent = np.minimum(way, end)
            forces[:] = way
            forces *= slope
            way -= 0.5 * bent
            way *= bent
            way *= bend
            forces += way
            forces += rest
        return forces.reshape(-1).copy()
