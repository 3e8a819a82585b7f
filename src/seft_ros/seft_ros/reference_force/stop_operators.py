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
    e: Floats, thresholds: Floats, powers: Floats | None = None, start: float | Floats = 0.0
) -> Floats:
    """Give the stop operators of a deformation, (N,), which begin with some values; (N, m).

    ``powers`` are n of each, (m,), without all 0: a corner.
    """
    stops = np.empty((len(e), len(thresholds)))
    stops[0] = start
    powers = np.zeros(len(thresholds)) if powers is None else powers
    _follow(np.ascontiguousarray(e), thresholds, powers, stops)
    return stops


@compiled
def _raised(y: float, power: float) -> float:
    """Raise a number to 1, 2 or 4: many times faster than to any power."""
    square = y * y
    return y if power == 1.0 else square if power == 2.0 else square * square


@compiled
def _root(y: float, power: float) -> float:
    """Give the root of that power."""
    root = math.sqrt(y)
    return y if power == 1.0 else root if power == 2.0 else math.sqrt(root)


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
    share = abs(z) / limit
    u = (abs(change) - back) / limit + share / _root(max(1.0 - _raised(share, power), 1e-12), power)
    return sign * limit * u / _root(1.0 + _raised(u, power), power)


@compiled
def _follow(e: Floats, thresholds: Floats, powers: Floats, stops: Floats) -> None:
    """Let stop operators follow a deformation, (N,), from the first row of the result, (N, m)."""
    for k in range(1, len(e)):
        for i in range(len(thresholds)):
            stops[k, i] = move_stop(stops[k - 1, i], e[k] - e[k - 1], thresholds[i], powers[i])
