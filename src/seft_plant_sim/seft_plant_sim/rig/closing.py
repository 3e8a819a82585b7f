"""How a valve closes where a test ends.

A valve that closes at once on a mass M that moves with v makes the oil, of stiffness k, hammer with
v sqrt(k M). Half a cosine has no corner at which the oil would ring.
"""

import math

from seft_plant_sim.compiled import compiled


@compiled
def left_open(taken: int, steps: float) -> float:
    """Part of the last command that is left after some of the steps in which a valve closes."""
    if taken >= steps:
        return 0.0
    return 0.5 * (1.0 + math.cos(math.pi * taken / steps))
