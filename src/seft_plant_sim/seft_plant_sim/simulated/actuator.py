"""Parameters of a servo-hydraulic actuator.

Oil column, valve flow and leakage after Merritt (Hydraulic Control Systems, 1967, ch. 6).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.parameter_table import per_axis

from seft_plant_sim.compiled import compiled, smooth_sign


@dataclass(frozen=True)
class Hydraulics:
    """Parameters of the actuators of n axes, each array of shape (n,).

    Attributes
    ----------
    oil_stiffness : ndarray
        k_oil, stiffness of the oil column, N/m.
    leakage : ndarray
        lambda, rate at which the force decays by leakage, 1/s.
    flow_gain : ndarray
        q, piston velocity for one volt without load, m/s/V.
    rated_voltage : ndarray
        Drive in V at which the valve is fully open.
    force_capacity : ndarray
        F_s, force at supply pressure, N.
    valve_frequency, valve_damping : ndarray
        Natural frequency in Hz and damping ratio of the valve.
    friction, friction_velocity : ndarray
        Coulomb friction of the piston in N, and the velocity in m/s over which it builds up.
    viscous_friction : ndarray
        Viscous friction of the piston, N s/m.
    stroke : ndarray
        Largest displacement in both directions, m.
    dead_time : ndarray
        Dead time of the valve, s.
    """

    oil_stiffness: Floats
    leakage: Floats
    flow_gain: Floats
    rated_voltage: Floats
    force_capacity: Floats
    valve_frequency: Floats
    valve_damping: Floats
    friction: Floats
    friction_velocity: Floats
    viscous_friction: Floats
    stroke: Floats
    dead_time: Floats

    @classmethod
    def from_parameters(cls, group: dict[str, Any], axes: Sequence[str]) -> "Hydraulics":
        """Make it from the parameters ``simulated.actuator.*``.

        Raises
        ------
        InputError
            If sizes do not fit the axes.
        """
        where, names = "rig: simulated.actuator", cls.__dataclass_fields__
        return cls(*(per_axis(group[name], axes, f"{where}.{name}") for name in names))

    def part(self, places: Sequence[int]) -> "Hydraulics":
        """Take the actuators at some places among the axes."""
        return replace(self, **{k: v[list(places)] for k, v in vars(self).items()})


@dataclass(frozen=True)
class InnerLoop:
    """The vendor's displacement controllers of n axes, each array of shape (n,).

    With the command u, the displacement x and the oil's force p, the drive of the valve is::

        P e + I integral of e + D e' / (1 + s / w_d) - Delta p,    e = gain u - x

    Attributes
    ----------
    gain : ndarray
        Displacement per command at rest, without load.
    proportional, integral, derivative : ndarray
        P, I and D: V/m, V/(m s) and V s/m.
    derivative_filter : ndarray
        w_d, cut-off of the derivative, Hz.
    delta_p : ndarray
        Delta, feedback of the oil's force, V/N.
    """

    gain: Floats
    proportional: Floats
    integral: Floats
    derivative: Floats
    derivative_filter: Floats
    delta_p: Floats

    @classmethod
    def from_parameters(
        cls, group: dict[str, Any], axes: Sequence[str], places: Sequence[int]
    ) -> "InnerLoop":
        """Make those of the axes at some places from ``simulated.actuator.*``.

        Raises
        ------
        InputError
            If sizes do not fit the axes.
        """
        where, names = "rig: simulated.actuator", [f"servo.{n}" for n in cls.__dataclass_fields__]
        every = (per_axis(group[name], axes, f"{where}.{name}") for name in names)
        return cls(*(values[list(places)] for values in every))


STOP_STIFFNESS = 2.0  # of the end stops, over the oil's
STOP_DAMPING = 2.0  # s/m: a stop pushes that much harder per velocity (Hunt & Crossley 1975)
STALL = 1e-4  # of the force capacity: below it the square root of the flow is smoothed
OPENING, PER_CAPACITY, STROKE_COLUMN, FRICTION, PER_VELOCITY, _STOP, FASTEST = range(7)
"""Columns of `piston_rows`."""
COLUMNS = 7


def piston_rows(hydraulics: Hydraulics, mass: Floats) -> Floats:
    """Put n actuators, whose pistons move masses (n,) in kg, into rows for the compiled functions.

    Each has its opening limit (V), 1 / force capacity (1/N), stroke (m), friction (N), 1 / friction
    velocity (s/m), stiffness of the stops (N/m), and the largest rate at which friction or stops
    answer (1/s); shape (n, 7).
    """
    h = hydraulics
    stop = STOP_STIFFNESS * h.oil_stiffness
    slope = np.where(h.friction > 0, h.friction / h.friction_velocity, 0.0)
    fastest = np.maximum(np.sqrt(stop / mass), slope / mass)
    ends = (h.rated_voltage, 1.0 / h.force_capacity, h.stroke)
    return np.column_stack([*ends, h.friction, 1.0 / h.friction_velocity, stop, fastest])


@compiled
def lost_opening(pistons: Floats, i: int, w: float, p: float, supply: float) -> float:
    """Valve's effective opening less its opening ``w`` (V), at a force ``p`` of the oil (N).

    ``supply`` is the supply pressure over its nominal value.
    """
    limit, load = pistons[i, OPENING], pistons[i, PER_CAPACITY] * p
    opening = limit if w > limit else -limit if w < -limit else w
    left = supply - load if w >= 0.0 else supply + load
    # root of the remaining supply pressure; below zero the flow reverses
    return opening * left / math.sqrt(max(abs(left), STALL)) - w


@compiled
def holding_force(pistons: Floats, i: int, x: float, v: float) -> float:
    """Force of friction and end stops on a piston at ``x`` (m) with velocity ``v`` (m/s), N."""
    friction, stroke = pistons[i, FRICTION], pistons[i, STROKE_COLUMN]
    force = friction * smooth_sign(v * pistons[i, PER_VELOCITY]) if friction else 0.0
    if x > stroke:
        force += pistons[i, _STOP] * (x - stroke) * max(0.0, 1.0 + STOP_DAMPING * v)
    elif x < -stroke:
        force += pistons[i, _STOP] * (x + stroke) * max(0.0, 1.0 - STOP_DAMPING * v)
    return force
