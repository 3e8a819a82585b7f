"""What is not linear in a servo-hydraulic actuator: flow, friction and end stops, compiled."""

import math

import numpy as np
import numpy.typing as npt

from seft_plant_sim.compiled import compiled
from seft_plant_sim.hydraulics import Hydraulics

Floats = npt.NDArray[np.float64]

STOP_STIFFNESS = 2.0  # of the end stops, over the oil's
STOP_DAMPING = 2.0  # s/m: a stop pushes that much harder per velocity (Hunt & Crossley 1975)
STALL = 1e-4  # of the force capacity: where the square root of the flow is rounded off
OPENING, PER_CAPACITY, STROKE, FRICTION, PER_VELOCITY, STOP, FASTEST = range(7)
"""Columns of `piston_rows`."""
COLUMNS = 7


def piston_rows(hydraulics: Hydraulics, mass: Floats) -> Floats:
    """Put actuators into rows that the compiled functions take.

    Parameters
    ----------
    hydraulics : Hydraulics
        Of n actuators.
    mass : ndarray
        Mass that each piston moves, shape (n,), kg.

    Returns
    -------
    ndarray
        Shape (n, 7), of each actuator: opening limit (V), 1 / force capacity (1/N), stroke (m),
        friction (N), 1 / friction velocity (s/m), stiffness of the stops (N/m), and the largest
        rate at which friction or stops answer (1/s).
    """
    h = hydraulics
    stop = STOP_STIFFNESS * h.oil_stiffness
    slope = np.where(h.friction > 0, h.friction / h.friction_velocity, 0.0)
    fastest = np.maximum(np.sqrt(stop / mass), slope / mass)
    ends = (h.opening_limit, 1.0 / h.force_capacity, h.stroke)
    return np.column_stack([*ends, h.friction, 1.0 / h.friction_velocity, stop, fastest])


@compiled
def lost_opening(pistons: Floats, i: int, w: float, p: float) -> float:
    """Valve's effective opening less its opening ``w`` (V), at a force ``p`` of the oil (N)."""
    limit, load = pistons[i, OPENING], pistons[i, PER_CAPACITY] * p
    opening = limit if w > limit else -limit if w < -limit else w
    left = 1.0 - load if w >= 0.0 else 1.0 + load
    # the root of what is left of the supply pressure; back through the valve below zero
    return opening * left / math.sqrt(max(abs(left), STALL)) - w


@compiled
def holding_force(pistons: Floats, i: int, x: float, v: float) -> float:
    """Force of friction and end stops on a piston at ``x`` (m) with velocity ``v`` (m/s), N."""
    friction, stroke = pistons[i, FRICTION], pistons[i, STROKE]
    force = 0.0
    if friction:  # tanh(v / over) by one exponential
        faded = math.exp(-2.0 * abs(v) * pistons[i, PER_VELOCITY])
        force = math.copysign(friction, v) * (1.0 - faded) / (1.0 + faded)
    if x > stroke:
        force += pistons[i, STOP] * (x - stroke) * max(0.0, 1.0 + STOP_DAMPING * v)
    elif x < -stroke:
        force += pistons[i, STOP] * (x + stroke) * max(0.0, 1.0 - STOP_DAMPING * v)
    return force
