"""Where in frequency the instability of a planned test would start."""

import cmath
import math

from seft_ros.preflight.margins import critical_dead_time, highest_gain
from seft_ros.preflight.plan import Plan
from seft_ros.preflight.search import NEUTRAL

HALF_WIDTH = math.sqrt(2.0)
"""Factor between the frequencies found and the band's edges: half an octave."""


def instability_band(plan: Plan) -> tuple[float, float] | None:
    """Find the band in which oscillations set in as the loop loses its margins.

    It spans the frequencies at which the loop turns unstable with more gain and with more dead
    time, and of an unstable plan that of its fastest growing oscillation, and half an octave on
    either side.

    Parameters
    ----------
    plan : Plan
        The test.

    Returns
    -------
    tuple of float or None
        Lowest and highest frequency, Hz, up to Nyquist's; None if it stays stable as far as was
        looked, or what grows does not oscillate.
    """
    stable = plan.growth_rate() <= NEUTRAL
    ends = [highest_gain(plan), critical_dead_time(plan)] if stable else [critical_dead_time(plan)]
    found = [end.hz for end in ends if end is not None]
    if not stable:
        found.append(abs(cmath.phase(plan.worst())) / math.tau / plan.dt)
    oscillating = [hz for hz in found if hz > 0]
    if not oscillating:
        return None
    nyquist = 0.5 / plan.dt
    return min(oscillating) / HALF_WIDTH, min(max(oscillating) * HALF_WIDTH, nyquist)
