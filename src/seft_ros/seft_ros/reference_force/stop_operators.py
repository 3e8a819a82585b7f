"""Stop operators, of whose sums a law with hysteresis is made, see `restoring_model`.

One with the bound y, z, unloads as the deformation e does, and away from 0 it has a corner, or is
round with n = 1, 2 or 4 (Menegotto & Pinto 1973)::

    z / y = u / (1 + u^n)^(1/n),  u' = |e'| / y                                            (1)
"""

import math

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_plant_sim.compiled import bounded, compiled


def stop_operators(
    e: Floats, thresholds: Floats, powers: float | Floats = 0.0, start: float | Floats = 0.0
) -> Floats:
    """Give the stop operators of a deformation, (N,), which begin with some values; (N, m).

    ``powers`` are n of each, 0: a corner.
    """
    stops = np.empty((len(e), len(thresholds)))
    stops[0] = start
    _follow(np.ascontiguousarray(e), thresholds, powers + np.zeros(len(thresholds)), stops)
    return stops


@compiled
def _bent(y: float, power: float, sense: float) -> float:
    """Give y / (1 + y^n)^(1/n), or its inverse with a sense of -1; n is 1, 2 or 4."""
    square = y * y
    if power == 1.0:
        return y / max(1.0 + sense * y, 1e-12)
    if power == 2.0:
        return y / math.sqrt(max(1.0 + sense * square, 1e-12))
    return y / math.sqrt(math.sqrt(max(1.0 + sense * square * square, 1e-12)))


@compiled
def move_stop(z: float, change: float, limit: float, power: float) -> float:
    """Move a stop operator, Eq. (1)."""
    if power == 0.0:
        return bounded(z + change, limit)
    sign = math.copysign(1.0, change)
    back = min(max(-z * sign, 0.0), abs(change))
    z += sign * back
    if back == abs(change):
        return z
    u = (abs(change) - back) / limit + _bent(abs(z) / limit, power, -1.0)
    return sign * limit * _bent(u, power, 1.0)


@compiled
def _follow(e: Floats, thresholds: Floats, powers: Floats, stops: Floats) -> None:
    """Let stop operators follow a deformation, (N,), from the first row of the result, (N, m)."""
    for k in range(1, len(e)):
        for i in range(len(thresholds)):
            stops[k, i] = move_stop(stops[k - 1, i], e[k] - e[k - 1], thresholds[i], powers[i])
