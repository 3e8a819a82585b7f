"""The tests of a tournament: methods, mass ratios, and rigs that are known and not quite known."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.parameter_table import Section, nearest, per_axis
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import Timebase
from seft_plant_sim import rig_parameters
from seft_plant_sim.rig import Rig

from seft_ros.force_controller.methods import force_control
from seft_ros.ground_motion.ground_motion_block import GroundMotion
from seft_ros.reference_force.compensation_methods import METHODS
from seft_ros.reference_force.reference_force_block import knowledge
from seft_ros.reference_force.reference_force_parameters import TABLE
from seft_ros.test_run.compiled_loop import build_blocks, with_method

UNCERTAINTY = {
    "specimen.mass": 0.2,  # it is weighed
    "specimen.damping": 5.0,
    "specimen.stiffness": 1.0,
    "specimen.yield_displacement": 1.0,
    "actuator.delay": 1.0,
    "actuator.oil_stiffness": 1.0,
    "actuator.oil_column_frequency": 0.5,  # the root of a stiffness
    "actuator.bulk_modulus": 1.0,
    "actuator.flow_gain": 1.0,
    "actuator.rated_flow": 1.0,
    "actuator.leakage": 3.0,
    "actuator.leakage_coefficient": 3.0,
    "actuator.valve_frequency": 1.0,
    "actuator.valve_damping": 1.0,
    "actuator.dead_time": 1.0,
    "actuator.friction": 3.0,
    "specimen.friction.force": 1.0,
    "specimen.gap.width": 1.0,
    "specimen.gap.stiffness": 1.0,
    "specimen.duffing.cubic": 1.0,
}
"""How uncertain each parameter of a rig is, in units of the spread; new ones go to the end."""


class Entry(NamedTuple):
    """One test: mass ratio, number of the rig (0: as configured), compensation method."""

    mass_ratio: float
    rig: int
    method: str

    def __str__(self) -> str:
        return f"mass ratio {self.mass_ratio:g}, rig {self.rig}, {self.method}"


@dataclass(frozen=True)
class Tournament:
    """Every method runs at every mass ratio on every rig.

    Attributes
    ----------
    experiment : Experiment
        What all tests share.
    methods : tuple of str
        Compensation methods.
    mass_ratios : tuple of float
        Computed mass over the model's mass.
    rigs : tuple of dict
        Parameters of the rigs; the first is the configured one. The reference force's model of
        the specimen stays as configured.
    not_possible : dict
        (mass ratio, method) -> why it can't be set up.
    """

    experiment: Experiment
    methods: tuple[str, ...]
    mass_ratios: tuple[float, ...]
    rigs: tuple[Section, ...]
    not_possible: dict[tuple[float, str], str]

    def entries(self) -> list[Entry]:
        """List the tests that are possible, those of one rig together."""
        return [
            Entry(ratio, number, method)
            for ratio in self.mass_ratios
            for number in range(len(self.rigs))
            for method in self.methods
            if (ratio, method) not in self.not_possible
        ]

    def tests(self) -> list[tuple[Entry, Experiment]]:
        """List them for `seft_ros.ensemble.runs.run_tests`."""
        return [(entry, self.experiment_of(entry)) for entry in self.entries()]

    def experiment_of(self, entry: Entry) -> Experiment:
        """Give the complete experiment of one test."""
        found = with_method(self.experiment, entry.method).sections
        force = found["reference_force"] | {"mass_ratio": entry.mass_ratio}
        return Experiment(found | {"reference_force": force, "rig": self.rigs[entry.rig]})


def make_tournament(
    experiment: Experiment,
    methods: Sequence[str] = (),
    mass_ratios: Sequence[float] = (),
    *,
    rigs: int = 1,
    seed: int = 1,
    spread: float = 0.1,
) -> Tournament:
    """Set a tournament up.

    Parameters
    ----------
    experiment : Experiment
        What all tests share.
    methods, mass_ratios : sequence
        Default all methods, and the experiment's own mass ratio.
    rigs : int
        Number of rigs, the configured one included.
    seed, spread : int, float
        Of the other rigs, see `perturbed_rig`.

    Raises
    ------
    InputError
        If a method is unknown, a mass ratio is out of bounds, a rig is impossible, or the
        experiment can't be run with any method.
    """
    for name in methods:
        if name not in METHODS:
            raise InputError(
                f"there is no compensation method {name}; it must be one of "
                f"{', '.join(METHODS)}{nearest(name, METHODS)}"
            )
    own = experiment["reference_force"]["mass_ratio"]
    ratios = [TABLE.check({"mass_ratio": ratio})["mass_ratio"] for ratio in mass_ratios or [own]]
    axes, timebase = experiment.axes, experiment.timebase
    sections = [
        perturbed_rig(experiment["rig"], axes, seed, number, spread) for number in range(rigs)
    ]
    # errors of the experiment itself come before those of a method
    GroundMotion.from_parameters(experiment["ground_motion"], axes, timebase)
    knowledge(experiment["reference_force"], axes, timebase)
    force_control(experiment["force_controller"], axes, timebase)
    for number, section in enumerate(sections):
        check_rig(section, axes, timebase, number)
    chosen = tuple(dict.fromkeys(methods or METHODS))
    tournament = Tournament(experiment, chosen, tuple(dict.fromkeys(ratios)), tuple(sections), {})
    for ratio, method in product(tournament.mass_ratios, tournament.methods):
        try:
            build_blocks(tournament.experiment_of(Entry(ratio, 0, method)))
        except InputError as error:  # all else is in order: the method lacks something
            tournament.not_possible[ratio, method] = str(error)
    if not tournament.entries():
        raise InputError(f"no method is possible: {next(iter(tournament.not_possible.values()))}")
    return tournament


def perturbed_rig(
    section: Section, axes: Sequence[str], seed: int, number: int, spread: float
) -> Section:
    """Draw the parameters of a rig; number 0 is the configured rig itself.

    Each parameter p of `UNCERTAINTY` becomes p (1 + uncertainty spread)^d, with its own d drawn
    uniformly between -1 and 1: with a spread of 0.2 the stiffness is up to 20 % too high or too
    low, and the damping up to twice or half. Actuators differ from axis to axis; the matrices of
    the specimen are scaled as a whole. Zero stays zero. The seed of the sensor noise is drawn too.

    Parameters
    ----------
    section : dict
        Values of every parameter of the rig.
    axes : sequence of str
        Names of the axes.
    seed, number : int
        The draw depends on these two alone.
    spread : float
        At least 0.
    """
    if number == 0:
        return dict(section)
    random = np.random.default_rng([seed, number])
    drawn: Section = {"seed": int(random.integers(2**31))}
    for name, uncertainty in UNCERTAINTY.items():
        factors = draw_factors(random, uncertainty, spread, len(axes))
        value, kind = section[name], rig_parameters.TABLE.rows[name].kind
        if len(axes) > 1 and kind == "floats" and name.startswith("actuator."):
            drawn[name] = (per_axis(value, axes, f"rig: {name}") * factors).tolist()
        else:
            drawn[name] = np.multiply(value, float(factors[0])).tolist()
    return section | drawn


def draw_factors(random: np.random.Generator, uncertainty: float, spread: float, n: int) -> Floats:
    """Draw n factors between 1 / most and most = 1 + uncertainty * spread, as likely up as down."""
    factors: Floats = (1.0 + uncertainty * spread) ** random.uniform(-1.0, 1.0, n)
    return factors


def check_rig(section: Section, axes: tuple[str, ...], timebase: Timebase, number: int) -> None:
    """Refuse impossible parameters; the InputError names the rig's number if it is not 0."""
    try:
        Rig.from_parameters(rig_parameters.TABLE.check(section), axes, timebase)
    except InputError as error:
        if number == 0:
            raise
        raise InputError(
            f"perturbed rig {number}: {error}; a smaller spread keeps rigs possible"
        ) from None
