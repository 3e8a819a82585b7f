"""Stiffness and damping of the specimen, identified while the test runs."""

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

STIFFNESS_RANGE = (0.25, 4.0)  # of what is known at the start
LARGEST_DAMPING = 6.0  # likewise, or of the least one that is reckoned with
_LEAST_DAMPING_RATIO = 0.02
_STIFFNESS_SPREAD, _DAMPING_SPREAD = 0.3, 1.0  # uncertainty at the start, relative
_EXCITATION = 1.5  # RMS of the restoring force over its noise, below which nothing is learnt
BLOCK = 10  # samples that are learnt from at once
_SIGNIFICANT = 3.0  # by each parameter beyond one axis's, see `contradicts`
_EXCITATION_TIME = 0.1  # s over which that is taken


class SpecimenIdentification:
    """Recursive least squares of the restoring force on displacement and velocity.

    r = K x + C v, n axes, K and C symmetric; a Kalman filter of constant parameters, in its
    information form and by blocks of samples, which starts at what is known with its
    uncertainty. Without excitation nothing moves, and noise averages
    out; samples that hardly stand out of the noise, which would make the specimen seem soft, are
    left out.

    Parameters
    ----------
    mass, damping, stiffness : ndarray
        As known at the start, shape (n, n).
    noise : ndarray
        Covariance of what noise makes of r - (K x + C v), shape (n, n), N^2.
    dt : float
        Sampling period, s.

    Attributes
    ----------
    restoring : ndarray
        (K, C), shape (n, 2n), within bounds.
    variance : ndarray
        Part that the parameters have in the variance of the restoring force expected of the
        last sample, shape (n,), N^2.
    """

    def __init__(
        self, mass: Floats, damping: Floats, stiffness: Floats, noise: Floats, dt: float
    ) -> None:
        n = len(mass)
        diagonal = np.abs(np.diag(stiffness))
        critical = 2 * np.sqrt(diagonal * np.diag(mass))
        damped = np.maximum(np.diag(damping), _LEAST_DAMPING_RATIO * critical)
        self._lowest = np.concatenate([STIFFNESS_RANGE[0] * diagonal, np.zeros(n)])
        self._highest = np.concatenate([STIFFNESS_RANGE[1] * diagonal, LARGEST_DAMPING * damped])
        self._diagonal = (np.tile(np.arange(n), 2), np.arange(2 * n))
        # which parameter stands where in (K, C): those of the upper triangles, K first
        upper, count = np.triu_indices(n), n * (n + 1) // 2
        places = np.zeros((n, n), dtype=int)
        places[upper] = places[upper[::-1]] = np.arange(count)
        self._places = np.hstack([places, count + places])
        self._start = np.hstack([stiffness[upper], damping[upper]])
        spread = np.outer([_STIFFNESS_SPREAD / n, _DAMPING_SPREAD / n], np.ones(n)) * [
            diagonal,
            damped,
        ]
        self._spread = np.sqrt(spread[:, upper[0]] * spread[:, upper[1]]).reshape(-1)
        # (x, v) to the force that a parameter of its spread makes on an axis
        self._regression = np.zeros((n, 2 * count, 2 * n))
        for axis, columns in enumerate(self._places):
            self._regression[axis, columns, np.arange(2 * n)] = 1.0
        self._regression *= self._spread[:, np.newaxis]
        # the same over the noise, which is made independent and of variance one
        self._whitening = np.linalg.inv(np.linalg.cholesky(noise))
        self._white = np.tensordot(self._whitening, self._regression, axes=1)
        self._least = n * _EXCITATION**2
        self._forgetting = 1.0 - np.exp(-BLOCK * dt / _EXCITATION_TIME)
        self._motions, self._forces = np.zeros((BLOCK, 2 * n)), np.zeros((BLOCK, n))
        self.reset()

    def reset(self) -> None:
        """Go back to what was known."""
        count, n = len(self._spread), len(self._regression)
        self._changes = np.zeros(count)  # of the parameters, over their spread
        self._taken = self._changes
        self._information, self._evidence = np.eye(count), np.zeros(count)
        self._uncertainty = self._quadratic(np.eye(count))
        self.restoring = self._start[self._places]
        self._first = self.restoring.copy()
        self.variance = np.zeros(n)
        self._excitation, self._filled = 0.0, 0

    def step(self, motion: Floats, restoring_force: Floats) -> bool:
        """Take a sample in.

        Parameters
        ----------
        motion : ndarray
            (x, v), shape (2n,).
        restoring_force : ndarray
            Measured, shape (n,), N.

        Returns
        -------
        bool
            Whether a block of samples is full, and was learnt from.
        """
        self._motions[self._filled], self._forces[self._filled] = motion, restoring_force
        self._filled += 1
        self.variance = self._uncertainty.dot(motion).dot(motion)
        if self._filled < BLOCK:
            return False
        self._filled = 0
        self._learn()
        return True

    def _learn(self) -> None:
        """Take the block's samples over into the parameters, as they stand out of the noise."""
        expected = self._motions @ self._first.T  # of the specimen as known at the start
        power = np.square(expected @ self._whitening.T).sum() / BLOCK
        self._excitation += self._forgetting * (power - self._excitation)
        if self._excitation <= self._least:
            return
        regressors = (self._white @ self._motions.T).transpose(1, 0, 2)
        regressors = regressors.reshape(len(self._spread), -1)
        errors = (self._forces - expected) @ self._whitening.T
        self._information += regressors @ regressors.T
        self._evidence += regressors @ errors.T.reshape(-1)
        covariance = np.linalg.inv(self._information)
        self._changes = covariance @ self._evidence
        self._uncertainty = self._quadratic(covariance)

    def _quadratic(self, covariance: Floats) -> Floats:
        """Forms of (x, v) that give the variance of each axis's expected force, (n, 2n, 2n)."""
        forms: Floats = self._regression.transpose(0, 2, 1) @ covariance @ self._regression
        return forms

    def contradicts(self) -> bool:
        """Tell whether the measurements speak against the parameters that were taken last.

        The squared distance of the estimate from them, over its covariance, is about the number
        of parameters where they are right. The more axes, the more the noise moves parameters
        that the motion hardly shows; to follow that would do harm. The two parameters of one axis
        are always followed.
        """
        distance = self._changes - self._taken
        likely = _SIGNIFICANT * (len(distance) - 2)
        return bool(distance.dot(self._information).dot(distance) >= likely)

    def take(self) -> None:
        """Note that the parameters are taken as they are now."""
        self._taken = self._changes

    def elastic(self) -> Floats:
        """Give the parameters that are best taken for the elastic ones once the specimen yields.

        What softens just before is not seen as yielding yet, and goes into the estimate. The two
        parameters of one axis stand it; the many of several axes may then be far from any specimen
        (half the stiffness of a storey in config/three_storey_frame.yaml), so that what was told
        is taken.
        """
        return self.bounded() if len(self._regression) == 1 else self._first

    def bounded(self) -> Floats:
        """Take the parameters over into `restoring`, within their bounds."""
        self.restoring[:] = (self._start + self._spread * self._changes)[self._places]
        diagonal = self.restoring[self._diagonal]
        self.restoring[self._diagonal] = np.clip(diagonal, self._lowest, self._highest)
        return self.restoring
