"""Gain and delay of the force loop beside its identified response, while the test runs."""

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

_SPREAD = (0.02, 1e-3)  # of the gain, and of the advance in s
_BOUNDS = (0.1, 4e-3)
_FORGETTING = 100.0  # s in which they may drift by their spread


class TrackingIdentification:
    """f = (1 + gain) y + advance dy/dt on each of n axes, y the force that the model expects.

    A Kalman filter of slowly drifting parameters. y comes of the reference force alone, so
    that sensor noise does not bias them (after Chae et al. 2013, where both sides are measured).

    Parameters
    ----------
    axes : int
        n.
    noise : ndarray
        Variance of f, shape (n,), N^2.
    dt : float
        Sampling period, s.

    Attributes
    ----------
    gain, advance : ndarray
        Shape (n,), 1 and s.
    """

    def __init__(self, axes: int, noise: Floats, dt: float) -> None:
        self._axes, self._noise, self._dt = axes, noise, dt
        self._drift = [spread**2 * dt / _FORGETTING for spread in _SPREAD]
        self.reset()

    def reset(self) -> None:
        """Trust the identified response."""
        self._parameters = np.zeros((2, self._axes))
        self.gain, self.advance = self._parameters
        # of each axis: variance of gain, covariance, variance of advance
        self._covariance = [[_SPREAD[0] ** 2, 0.0, _SPREAD[1] ** 2] for _ in range(self._axes)]
        self._last = [0.0] * self._axes
        self._samples = [(0.0, 0.0, 0.0)] * self._axes  # y, dy/dt, deviation

    def deviation(self, model_force: Floats, force: Floats) -> list[float]:
        """Force beside what is expected with the parameters as they are, of each axis, N."""
        expected = model_force.tolist()
        of_axes = zip(expected, self._last, force.tolist(), *self._parameters.tolist(), strict=True)
        self._samples = [
            (y, (rate := (y - last) / self._dt), f - (1.0 + gain) * y - advance * rate)
            for y, last, f, gain, advance in of_axes
        ]
        self._last = expected
        return [error for _, _, error in self._samples]

    def update(self, variance: Floats) -> None:
        """Learn from the last deviation.

        Parameters
        ----------
        variance : ndarray
            That it has beside the noise, of what is not known of the specimen, shape (n,), N^2.
        """
        of_axes = zip(
            self._samples,
            self._parameters.T.tolist(),
            self._covariance,
            (self._noise + variance).tolist(),
            strict=True,
        )
        for axis, ((y, rate, error), (gain, advance), covariance, noise) in enumerate(of_axes):
            own, shared, other = covariance
            part, other_part = own * y + shared * rate, shared * y + other * rate
            scale = 1.0 / (noise + part * y + other_part * rate)
            self._parameters[:, axis] = (
                min(max(gain + part * scale * error, -_BOUNDS[0]), _BOUNDS[0]),
                min(max(advance + other_part * scale * error, -_BOUNDS[1]), _BOUNDS[1]),
            )
            covariance[:] = (
                min(own - part * part * scale + self._drift[0], _SPREAD[0] ** 2),
                shared - part * other_part * scale,
                min(other - other_part * other_part * scale + self._drift[1], _SPREAD[1] ** 2),
            )
