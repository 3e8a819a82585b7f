"""Sensors of the rig: what the data acquisition sees of the true motion and force."""

from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.arrays import per_axis

Floats = npt.NDArray[np.float64]

BLOCK = 4096


class Sensors:
    """White measurement noise, a function of seed and step alone.

    A sample's noise does not depend on which samples were taken before: steps may be skipped
    or repeated, and every way of running a test sees the same noise.

    Parameters
    ----------
    noise : ndarray
        RMS noise of displacement (m), velocity (m/s), acceleration (m/s^2) and force (N),
        shape (4, n).
    seed : int
        Seed of the noise.
    """

    def __init__(self, noise: Floats, seed: int) -> None:
        self._noise = noise
        self._seed = seed
        self._block_index = -1
        self._block: Floats = np.empty((0, *noise.shape))

    @classmethod
    def from_parameters(
        cls, group: dict[str, Any], seed: int, axes: tuple[str, ...], where: str
    ) -> "Sensors":
        """Make them of the parameters ``position_noise`` ... ``force_noise``."""
        names = ("position_noise", "velocity_noise", "acceleration_noise", "force_noise")
        rows = [per_axis(group[name], axes, f"{where}.{name}") for name in names]
        return cls(np.array(rows), seed)

    def measure(self, step: int, state: Floats) -> Floats:
        """Measure the true state at a step.

        Parameters
        ----------
        step : int
            Step of the sample.
        state : ndarray
            True displacement, velocity, acceleration and force, shape (4, n).

        Returns
        -------
        ndarray
            As measured, shape (4, n).
        """
        index, row = divmod(step, BLOCK)
        if index != self._block_index:
            generator = np.random.default_rng([self._seed, index])
            self._block = generator.standard_normal((BLOCK, *self._noise.shape)) * self._noise
            self._block_index = index
        return np.add(state, self._block[row])
