"""Whether a rig that was stopped has come to rest."""

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

MEAN_OF = 0.05  # s over which velocities are averaged, so that noise is none


class Rest:
    """Follows the samples after a stop.

    Parameters
    ----------
    velocity : float
        What is slower counts as rest, m/s.
    dt : float
        Sampling period, s.

    Attributes
    ----------
    time : float
        Since the stop, s.
    peak_force : float
        Largest force of any actuator since then, N.
    """

    def __init__(self, velocity: float, dt: float) -> None:
        self._velocity, self._dt = velocity, dt
        self._window = max(1, round(MEAN_OF / dt))
        self.begin()

    def begin(self) -> None:
        """Begin to follow a stop."""
        self.time = self.peak_force = 0.0
        self._last: list[Floats] = []

    def is_reached(self, sample: Floats) -> bool:
        """Take the next sample, shape (4, n) in SI units; say whether the rig rests."""
        self.time += self._dt
        self.peak_force = max(self.peak_force, float(np.abs(sample[3]).max()))
        self._last = [*self._last[1 - self._window :], sample[1]]
        if len(self._last) < self._window:
            return False
        return bool(np.abs(np.mean(self._last, axis=0)).max() < self._velocity)
