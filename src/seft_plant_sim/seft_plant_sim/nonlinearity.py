"""What is not linear in a rig: residuals r(z) that are added to its linear model.

They work on plain floats: over the few axes of a test that is several times as fast as arrays.
The laws themselves are functions of floats, which the ensembles of seft_ros compile as they are.
"""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from seft_plant_sim.hydraulics import Hydraulics
from seft_plant_sim.specimen import Specimen

Floats = npt.NDArray[np.float64]

STOP_STIFFNESS = 2.0  # of the end stops, over the oil's
STOP_DAMPING = 2.0  # s/m: a stop pushes that much harder per velocity (Hunt & Crossley 1975)
STALL = 1e-4  # of the force capacity: where the square root of the flow is rounded off


class Part(Protocol):
    """Some residuals.

    Attributes
    ----------
    fastest : float
        Largest rate at which they answer a state, 1/s: a step must be shorter.
    """

    fastest: float

    def residuals(self, z: list[float]) -> list[float]:
        """Residuals at a state."""

    def saturated(self, z: list[float]) -> list[str]:
        """Name what is at the end of its range."""


@dataclass(frozen=True)
class Nonlinearity:
    """Residuals of a model, and where they act.

    Attributes
    ----------
    inputs, outputs : ndarray
        Shapes (s, r) and (4n, r): what r residuals add to the states' rates and to the outputs.
    parts : tuple of Part
        What makes the residuals, in order.
    drive_limit : float or ndarray
        Drive beyond which the actuator takes no notice, over the n axes.
    """

    inputs: Floats
    outputs: Floats
    parts: tuple[Part, ...]
    drive_limit: float | Floats = math.inf

    def beside(self, other: "Nonlinearity") -> "Nonlinearity":
        """Both together; the other's states contain all of this one's, first."""
        more = len(other.inputs) - len(self.inputs)
        return Nonlinearity(
            np.hstack([np.pad(self.inputs, ((0, more), (0, 0))), other.inputs]),
            np.hstack([self.outputs, other.outputs]),
            self.parts + other.parts,
            np.minimum(self.drive_limit, other.drive_limit),
        )


def lost_opening(w: float, p: float, limit: float, capacity: float) -> float:
    """Valve's effective opening less its opening ``w`` (V), at a force ``p`` of the oil (N)."""
    opening = limit if w > limit else -limit if w < -limit else w
    left = 1.0 - p / capacity if w >= 0.0 else 1.0 + p / capacity
    # the root of what is left of the supply pressure; back through the valve below zero
    root = left / math.sqrt(math.sqrt(left * left + STALL * STALL))
    return opening * root - w


def holding_force(
    x: float, v: float, stroke: float, friction: float, over: float, stop: float
) -> float:
    """Force of friction and end stops on a piston at ``x`` (m) with velocity ``v`` (m/s), N."""
    force = friction * math.tanh(v / over) if friction else 0.0
    if x > stroke:
        force += stop * (x - stroke) * max(0.0, 1.0 + STOP_DAMPING * v)
    elif x < -stroke:
        force += stop * (x + stroke) * max(0.0, 1.0 - STOP_DAMPING * v)
    return force


class PistonAndValve:
    """Flow through the valve, friction of the piston and end stops.

    The states begin with x, v, p, w, each over the n axes. The residuals are, per axis, the
    valve's effective opening less its opening (V), and the force that holds the piston (N).

    Parameters
    ----------
    hydraulics : Hydraulics
        Of n actuators.
    mass : ndarray
        Mass that each piston moves, shape (n,), kg.

    Attributes
    ----------
    rows : ndarray
        Shape (n, 6), of each actuator: opening limit, force capacity, stroke, friction, friction
        velocity, stiffness of the stops; as `lost_opening` and `holding_force` take them.
    """

    def __init__(self, hydraulics: Hydraulics, mass: Floats) -> None:
        h = hydraulics
        stop = STOP_STIFFNESS * h.oil_stiffness
        slope = np.where(h.friction > 0, h.friction / h.friction_velocity, 0.0)
        self.fastest = float(max(np.sqrt(stop / mass).max(), (slope / mass).max()))
        ends = (h.opening_limit, h.force_capacity, h.stroke)
        self.rows = np.transpose((*ends, h.friction, h.friction_velocity, stop))
        self._axes = [(index, *row) for index, row in enumerate(self.rows.tolist())]
        self._n = len(self._axes)

    def residuals(self, z: list[float]) -> list[float]:
        """Residuals at a state."""
        n = self._n
        flows, forces = [], []
        for i, limit, capacity, stroke, friction, over, stop in self._axes:
            flows.append(lost_opening(z[3 * n + i], z[2 * n + i], limit, capacity))
            forces.append(holding_force(z[i], z[n + i], stroke, friction, over, stop))
        return flows + forces

    def saturated(self, z: list[float]) -> list[str]:
        """Name what is at the end of its range: stroke, force capacity, valve."""
        n, found = self._n, []
        for i, limit, capacity, stroke, *_ in self._axes:
            if abs(z[i]) >= stroke:
                found.append("stroke")
            if abs(z[2 * n + i]) >= capacity:
                found.append("force_capacity")
            if abs(z[3 * n + i]) >= limit:
                found.append("valve")
        return found


class Springs:
    """Hysteresis of a specimen's springs.

    The states begin with x and v, each over the n axes; from ``first_state`` on stand the p
    springs' hysteretic displacements and the work on them. The residuals are, per spring, its
    force less the elastic one (N), the rate of the hysteretic displacement less that of the
    deformation (m/s), and the rate of the work.
    """

    def __init__(self, specimen: Specimen, first_state: int) -> None:
        n, p = specimen.axes, len(specimen.springs)
        self.fastest = 0.0  # no faster than the elastic specimen, which the linear model holds
        self.specimen, self.first_state = specimen, first_state
        self._springs = []
        for j, spring in enumerate(specimen.springs):
            row = enumerate(specimen.deformation[j].tolist())
            terms = [(i, n + i, factor) for i, factor in row if factor]
            self._springs.append((spring, terms, first_state + j, first_state + p + j))

    def residuals(self, z: list[float]) -> list[float]:
        """Residuals at a state."""
        forces, rates, works = [], [], []
        for spring, terms, z_at, work_at in self._springs:
            e = v = 0.0
            for x_at, v_at, factor in terms:
                e += factor * z[x_at]
                v += factor * z[v_at]
            hysteretic = z[z_at]
            forces.append(spring.force(e, hysteretic) - spring.stiffness * e)
            rates.append(spring.trial_rate(hysteretic, v, z[work_at]) - v)
            works.append(spring.work_rate(hysteretic, v))
        return forces + rates + works

    def settle(self, z: list[float]) -> None:
        """Bring the hysteretic displacements back between their bounds."""
        for spring, _, z_at, _ in self._springs:
            z[z_at] = spring.settle(z[z_at])

    def saturated(self, z: list[float]) -> list[str]:
        """Name nothing: a spring that yields is no range that ends."""
        del z
        return []
