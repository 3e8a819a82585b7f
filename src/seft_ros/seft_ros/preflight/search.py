"""Where stability ends along a line of changes."""

from collections.abc import Callable, Sequence
from itertools import pairwise

from scipy.optimize import brentq

NEUTRAL = 1e-6
"""Growth rate up to which a loop counts as stable, 1/s: what rounding makes of zero."""


def stability_change(growth: Callable[[float], float], points: Sequence[float]) -> float | None:
    """First place along some points where a loop turns from stable to unstable, or back.

    Brackets it between two neighbours and narrows it with Brent's method. What begins and ends
    between two neighbours is not seen.

    Parameters
    ----------
    growth : callable
        Growth rate of the loop in 1/s at a place.
    points : sequence of float
        Ascending or descending.

    Returns
    -------
    float or None
        None where nothing changes up to the last point.
    """

    def excess(place: float) -> float:
        return growth(place) - NEUTRAL

    before = excess(points[0])
    for near, far in pairwise(points):
        after = excess(far)
        if (before > 0) != (after > 0):
            return float(brentq(excess, near, far, xtol=1e-9 + 1e-6 * abs(far - near), rtol=1e-6))
        before = after
    return None
