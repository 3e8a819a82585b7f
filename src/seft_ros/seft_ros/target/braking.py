"""Points that nobody has told: a force stays, and a target loses its velocity."""

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

BRAKING = 0.03
"""Time constant with which a target loses its velocity, s. At a sudden stop its oil would ring."""


def continued(points: Floats, age: int, count: int, dt: float) -> Floats:
    """Give points from a step on, whether they have been told or not.

    Parameters
    ----------
    points : ndarray
        Those that have been told, shape (p, q, n).
    age : int
        Steps after the first of them.
    count : int
        Points wanted.
    dt : float
        Sampling period, s.

    Returns
    -------
    ndarray
        Shape (count, q, n).
    """
    last = len(points) - 1
    wanted = np.arange(age, age + count)
    found = points[np.minimum(wanted, last)]
    if found.shape[1] > 1:
        left = np.exp(-np.maximum(wanted - last, 0) * dt / BRAKING)[:, np.newaxis]
        found[:, 0] += BRAKING * (1.0 - left) * found[:, 1]
        found[:, 1] *= left
    return found
