"""Stiffness and damping of the specimen, identified while the test runs."""

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

STIFFNESS_RANGE = (0.25, 4.0)  # of what is known at the start
LARGEST_DAMPING = 6.0  # likewise, or of the least one that is reckoned with
_LEAST_DAMPING_RATIO = 0.02
_STIFFNESS_SPREAD, _DAMPING_SPREAD = 0.3, 1.0  # uncertainty at the start, relative
_EXCITATION = 5.0  # RMS of the restoring force over its noise, below which nothing is learnt
_EXCITATION_TIME = 0.1  # s over which that is taken


class SpecimenIdentification:
    """Recursive least squares of the restoring force on displacement and velocity.

    r = K x + C v, n axes, K and C symmetric; a Kalman filter of constant parameters, which starts
    at what is known with its uncertainty. Without excitation nothing moves, and noise averages
    out; samples that hardly stand out of the noise, which would make the specimen seem soft, are
    left out.

    Parameters
    ----------
    mass, damping, stiffness : ndarray
        As known at the start, shape (n, n).
    noise : float
        Variance of the measured restoring force, N^2.
    dt : float
        Sampling period, s.

    Attributes
    ----------
    restoring : ndarray
        (K, C), shape (n, 2n), within bounds.
    error, variance : ndarray
        Restoring force of the last sample less what was expected of it, and the part that the
        parameters have in the variance of that, shape (n,), N and N^2.
    """

    def __init__(
        self, mass: Floats, damping: Floats, stiffness: Floats, noise: float, dt: float
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
        self._axis = np.arange(n)[:, np.newaxis]
        self._start = np.hstack([stiffness[upper], damping[upper]])
        spread = np.outer([_STIFFNESS_SPREAD, _DAMPING_SPREAD], np.ones(n)) * [diagonal, damped]
        self._spread = np.sqrt(spread[:, upper[0]] * spread[:, upper[1]]).reshape(-1)
        self._regressors = np.zeros((n, 2 * count))
        self._noise = noise
        self._least = n * _EXCITATION**2 * noise
        self._forgetting = 1.0 - np.exp(-dt / _EXCITATION_TIME)
        self.reset()

    def reset(self) -> None:
        """Go back to what was known."""
        self._parameters = self._start.copy()
        self._covariance = np.diag(self._spread**2)
        self.restoring = self._start[self._places]
        self.error, self.variance = np.zeros((2, len(self.restoring)))
        self._excitation = 0.0

    def step(self, motion: Floats, restoring_force: Floats) -> None:
        """Take a sample in.

        Parameters
        ----------
        motion : ndarray
            (x, v), shape (2n,).
        restoring_force : ndarray
            Measured, shape (n,), N.
        """
        self._regressors[self._axis, self._places] = motion
        power = float(restoring_force.dot(restoring_force))
        self._excitation += self._forgetting * (power - self._excitation)
        learn = self._excitation > self._least
        for axis, regressor in enumerate(self._regressors):  # noise of the axes is their own
            part = self._covariance.dot(regressor)
            variance = max(regressor.dot(part), 0.0)
            error = restoring_force[axis] - regressor.dot(self._parameters)
            self.error[axis], self.variance[axis] = error, variance
            if learn:
                part_of_noise = part / (self._noise + variance)
                self._parameters += part_of_noise * error
                self._covariance -= part[:, np.newaxis] * part_of_noise

    def bounded(self) -> Floats:
        """Take the parameters over into `restoring`, within their bounds."""
        self.restoring[:] = self._parameters[self._places]
        diagonal = self.restoring[self._diagonal]
        self.restoring[self._diagonal] = np.clip(diagonal, self._lowest, self._highest)
        return self.restoring
