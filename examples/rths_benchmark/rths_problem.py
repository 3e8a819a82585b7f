"""The RTHS benchmark control problem (Silva et al. 2020): structure, plant, records and criteria.

A frame of three storeys; the first floor's spring and some of its mass stand in the laboratory, the
rest is computed. The actuator has a displacement controller of its own. The numbers are in
problem.yaml, SI units.
"""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from ruamel.yaml import YAML
from seft_msgs_py.arrays import Floats
from seft_msgs_py.errors import InputError
from seft_plant_sim.compiled import compiled, copy
from seft_plant_sim.lti import first_order_hold
from seft_plant_sim.simulated.specimen import Specimen
from seft_plant_sim.whole_structure import response

PROBLEM: dict[str, Any] = YAML(typ="safe").load(Path(__file__).with_name("problem.yaml"))
RATE = float(PROBLEM["rate"])
DT = 1.0 / RATE
FLOORS = 3
COMMAND_LIMIT, COMMAND_STEP = (PROBLEM["limits"][name] for name in ("command", "command_step"))
NOISE = {name: np.sqrt(value * RATE) for name, value in PROBLEM["noise_density"].items()}
"""Of the sensors, RMS at `RATE`: displacement (m) and force (N)."""
LONGEST_DELAY = 50
"""Samples to which J1 looks for a delay."""
SOURCE = "github.com/lihongweiseu/RTHS_benchmark_SMC has them"


class Plant(NamedTuple):
    """Actuator with its displacement controller, and specimen; fields as in problem.yaml."""

    gain: float
    a1b0: float
    a2: float
    a3: float
    b1: float
    b2: float
    mass: float
    damping: float
    stiffness: float
    capacity: float

    @classmethod
    def nominal(cls) -> "Plant":
        """Give the plant that the experimenter knows."""
        return cls._drawn(np.zeros(4))

    @classmethod
    def perturbed(cls, number: int, seed: int) -> "Plant":
        """Draw the perturbed plant of this number from a seed: a3, b1, b2 and the stiffness."""
        return cls._drawn(np.random.default_rng([seed, number]).standard_normal(4))

    @classmethod
    def _drawn(cls, z: Floats) -> "Plant":
        known = dict(PROBLEM["plant"])
        ratio = known.pop("damping_ratio")
        for value, (name, deviation) in zip(
            z.tolist(), PROBLEM["standard_deviation"].items(), strict=True
        ):
            known[name] += deviation * value
        known["damping"] = 2.0 * ratio * np.sqrt(known["mass"] * known["stiffness"])
        return cls(**known, capacity=PROBLEM["limits"]["force"])

    def command_to_displacement(self) -> tuple[Floats, Floats]:
        """Numerator and denominator of the response, in s, highest power first."""
        oil = np.polymul([1.0, self.a3], [self.mass, self.damping, self.stiffness])
        valve = [1.0, self.b1, self.b2]
        open_loop = np.polymul(valve, np.polyadd(oil, [self.a2, 0.0]))
        return np.array([self.gain * self.a1b0]), np.polyadd(open_loop, [self.a1b0])


VALVE, VALVE_RATE, FORCE, POSITION, VELOCITY = range(5)
"""States of the plant."""


@compiled
def plant_rate(plant: Plant, z: Floats, u: float, rate: Floats) -> None:
    """Rate of the plant's state, shape (5,), under the command u; written to ``rate``."""
    force = min(max(z[FORCE], -plant.capacity), plant.capacity)
    error = plant.gain * u - z[POSITION]
    rate[VALVE] = z[VALVE_RATE]
    rate[VALVE_RATE] = plant.a1b0 * error - plant.b1 * z[VALVE_RATE] - plant.b2 * z[VALVE]
    rate[FORCE] = z[VALVE] - plant.a2 * z[VELOCITY] - plant.a3 * z[FORCE]
    rate[POSITION] = z[VELOCITY]
    resisting = plant.damping * z[VELOCITY] + plant.stiffness * z[POSITION]
    rate[VELOCITY] = (force - resisting) / plant.mass


@compiled
def plant_step(plant: Plant, z: Floats, u: float, work: Floats) -> None:
    """Advance the state by `DT` under a constant command (Runge-Kutta); ``work`` has (3, 5)."""
    slope, at, total = work[0], work[1], work[2]
    total[:] = 0.0
    copy(len(z), z, at)
    for stage in range(4):
        plant_rate(plant, at, u, slope)
        weight = 2.0 if stage in (1, 2) else 1.0
        reach = DT if stage == 2 else 0.5 * DT
        for i in range(len(z)):
            total[i] += weight * slope[i]
            at[i] = z[i] + reach * slope[i]
    for i in range(len(z)):
        z[i] += DT / 6.0 * total[i]


@compiled
def quantised(command: float) -> float:
    """Command as the converter passes it on."""
    limited = min(max(command, -COMMAND_LIMIT), COMMAND_LIMIT)
    return np.round(limited / COMMAND_STEP) * COMMAND_STEP


@compiled
def march(free: Floats, start: Floats, change: Floats, inputs: Floats, states: Floats) -> None:
    """Fill the states, shape (N, s), from the first on, under inputs of shape (N, p).

    The matrices are those of `first_order_hold`.
    """
    for k in range(len(inputs) - 1):
        for i in range(states.shape[1]):
            total = 0.0
            for j in range(states.shape[1]):
                total += free[i, j] * states[k, j]
            for j in range(inputs.shape[1]):
                total += start[i, j] * inputs[k, j]
                total += change[i, j] * (inputs[k + 1, j] - inputs[k, j])
            states[k + 1, i] = total


class Structure:
    """The frame of one of the cases, split between computer and laboratory.

    Parameters
    ----------
    case : int
        1 to 4.
    plant : Plant
        Whose specimen is in the laboratory; the computer has the rest, also of a perturbed one.

    Attributes
    ----------
    whole, computed : tuple of ndarray
        Mass, damping and stiffness, shape (3, 3) each.
    """

    def __init__(self, case: int, plant: Plant) -> None:
        of_case = PROBLEM["cases"][case]
        self.whole = (
            of_case["mass"] * np.eye(FLOORS),
            np.array(of_case["damping"]),
            np.array(PROBLEM["stiffness"]),
        )
        first = np.zeros((FLOORS, FLOORS))
        first[0, 0] = 1.0
        physical = plant.mass, plant.damping, plant.stiffness
        self.computed = tuple(
            matrix - value * first for matrix, value in zip(self.whole, physical, strict=True)
        )

    def reference(self, ground: Floats) -> Floats:
        """Displacements of the whole frame, exact, shape (N, 3), m."""
        shaken = np.repeat(ground[:, np.newaxis], FLOORS, axis=1)
        return response(Specimen(*self.whole), shaken, DT)[0]

    @cached_property
    def state_space(self) -> tuple[Floats, Floats]:
        """A and B of the computed part: inputs are a_g and the force measured on the first floor.

        States are displacements, then velocities.
        """
        mass, damping, stiffness = self.computed
        inputs = -np.column_stack([self.whole[0] @ np.ones(FLOORS), np.eye(FLOORS)[0]])
        a = np.block(
            [
                [np.zeros((FLOORS, FLOORS)), np.eye(FLOORS)],
                [-np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, damping)],
            ]
        )
        return a, np.vstack([np.zeros((FLOORS, 2)), np.linalg.solve(mass, inputs)])

    def upper_floors(self, ground: Floats, first: Floats) -> Floats:
        """Displacements of all floors under a motion of the first one, shape (N, 3), m.

        ``first`` has displacement and velocity of the first floor, shape (N, 2); masses are lumped.
        """
        mass, damping, stiffness = (matrix[1:] for matrix in self.computed)
        coupled = np.hstack([mass @ np.ones((FLOORS, 1)), stiffness[:, :1], damping[:, :1]])
        own = np.hstack([stiffness[:, 1:], damping[:, 1:]])
        by_force = np.linalg.inv(mass[:, 1:])
        n = FLOORS - 1
        a = np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), -by_force @ own])
        b = np.vstack([np.zeros((n, FLOORS)), -by_force @ coupled])
        states = np.zeros((len(ground), 2 * n))
        free, start, change = map(np.ascontiguousarray, first_order_hold(a, b, DT))
        march(free, start, change, np.column_stack([ground, first]), states)
        return np.column_stack([first[:, 0], states[:, :n]])


def ground_motion(folder: Path, record: str) -> Floats:
    """Ground acceleration of a record at each sample, m/s^2: scaled, and linear in between.

    Raises
    ------
    InputError
        If the folder has no such file, or it has no column of numbers.
    """
    path = folder / f"{record}.txt"
    try:
        values = np.loadtxt(path, ndmin=1)
    except FileNotFoundError:
        raise InputError(
            f"{path}: is not there; the benchmark's records belong to its released code "
            f"({SOURCE}): save each unscaled, one number (m/s^2) a line, and name their folder "
            "with --data"
        ) from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: is no column of numbers ({error})") from None
    if values.ndim != 1 or len(values) < 2:
        raise InputError(f"{path}: must have one column of at least two numbers")
    time = np.arange(len(values)) * PROBLEM["records"][record]
    steps = int(time[-1] * RATE + 1e-6) + 1
    return np.asarray(PROBLEM["scale"] * np.interp(np.arange(steps) * DT, time, values))


@dataclass(frozen=True)
class Motion:
    """What a test moved.

    Attributes
    ----------
    measured, true : ndarray
        Displacement of the first floor in the laboratory, shape (N,), m.
    numerical : ndarray
        Displacements of the computed part's floors, shape (N, 3), m.
    trip : str
        Why the test ended early; empty if it did not.
    """

    measured: Floats
    true: Floats
    numerical: Floats
    trip: str = ""


def criteria(measured: Floats, numerical: Floats, reference: Floats) -> dict[str, float]:
    """Calculate J1 to J9: J1 in ms, the others in %.

    Parameters
    ----------
    measured : ndarray
        Displacement of the first floor in the laboratory, shape (N,), m.
    numerical, reference : ndarray
        Displacements of the computed part's floors and of the whole frame, shape (N, 3), m.
    """
    first = numerical[:, 0]
    correlation = [
        np.corrcoef(measured[lag:], first[: len(first) - lag])[0, 1] for lag in range(LONGEST_DELAY)
    ]
    pairs = (
        (measured, first),
        (measured, reference[:, 0]),
        (numerical[:, 1], reference[:, 1]),
        (numerical[:, 2], reference[:, 2]),
    )
    rms = [float(100.0 * np.std(y - x) / np.std(x)) for y, x in pairs]
    peak = [float(100.0 * np.abs(y - x).max() / np.abs(x).max()) for y, x in pairs]
    return {
        "J1": float(1e3 * DT * np.argmax(correlation)),
        **{"J2": rms[0], "J3": peak[0], "J4": rms[1], "J5": peak[1]},
        **{"J6": rms[2], "J7": rms[3], "J8": peak[2], "J9": peak[3]},
    }
