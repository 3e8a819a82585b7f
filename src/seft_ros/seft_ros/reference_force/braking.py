"""Points beyond those sent: a force stays, and a target loses its velocity."""

import math

import numpy as np
import numpy.typing as npt
from seft_plant_sim.compiled import compiled

Floats = npt.NDArray[np.float64]

BRAKING = 0.03
"""Time constant with which a target loses its velocity, s. At a sudden stop its oil would ring."""


@compiled
def go_on(points: Floats, age: int, dt: float, result: Floats) -> None:
    """Give points from a step on, whether they have been sent or not.

    Parameters
    ----------
    points : ndarray
        Those that have been sent, shape (p, q, n).
    age : int
        Steps after the first of them.
    dt : float
        Sampling period, s.
    result : ndarray
        The points wanted, shape (count, q, n).
    """
    last, (_, quantities, n) = len(points) - 1, points.shape
    for index in range(len(result)):
        sent, beyond = min(age + index, last), max(age + index - last, 0)
        left = math.exp(-beyond * dt / BRAKING)
        for i in range(n):
            for row in range(quantities):
                result[index, row, i] = points[sent, row, i]
            if quantities > 1:
                result[index, 0, i] += BRAKING * (1.0 - left) * points[sent, 1, i]
                result[index, 1, i] *= left


def continued(points: Floats, age: int, count: int, dt: float) -> Floats:
    """Give so many points, see `go_on`."""
    result = np.empty((count, *points.shape[1:]))
    go_on(points, age, dt, result)
    return result
