"""Who takes part in a tournament: methods, mass ratios, rigs, and the test that each makes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.parameter_table import Section, nearest
from seft_msgs_py.errors import InputError

from seft_ros.force_controller.methods import force_control
from seft_ros.ground_motion.ground_motion_block import GroundMotion
from seft_ros.reference_force.compensation_methods import METHODS
from seft_ros.reference_force.reference_force_block import knowledge
from seft_ros.reference_force.reference_force_parameters import TABLE
from seft_ros.test_run.blocks import build_blocks, with_method
from seft_ros.tournament.perturbed_rig import check_rig, perturbed_rig


class Entry(NamedTuple):
    """One test of a tournament: mass ratio, number of the rig (0: as configured), method."""

    mass_ratio: float
    rig: int
    method: str

    def __str__(self) -> str:
        return f"mass ratio {self.mass_ratio:g}, rig {self.rig}, {self.method}"


@dataclass(frozen=True)
class Tournament:
    """Methods, mass ratios and rigs, each of which meets each of the others.

    Attributes
    ----------
    experiment : Experiment
        What all tests share.
    methods : tuple of str
        Compensation methods.
    mass_ratios : tuple of float
        Computed mass over the model's mass.
    rigs : tuple of dict
        Parameters of the rigs; the first is the configured one. What the reference force
        believes of them stays as configured.
    not_possible : dict
        (mass ratio, method) -> why it can't be set up.
    """

    experiment: Experiment
    methods: tuple[str, ...]
    mass_ratios: tuple[float, ...]
    rigs: tuple[Section, ...]
    not_possible: dict[tuple[float, str], str]

    def pairs(self) -> list[tuple[float, str]]:
        """List mass ratios with the methods that are possible there."""
        return [
            (ratio, method)
            for ratio in self.mass_ratios
            for method in self.methods
            if (ratio, method) not in self.not_possible
        ]

    def entries(self) -> list[Entry]:
        """List the tests that are possible, those of one rig together."""
        return [
            Entry(ratio, number, method)
            for ratio in self.mass_ratios
            for number in range(len(self.rigs))
            for method in self.methods
            if (ratio, method) not in self.not_possible
        ]

    def experiment_of(self, entry: Entry) -> Experiment:
        """Experiment of one test, complete."""
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
    methods : sequence of str
        Default all that there are.
    mass_ratios : sequence of float
        Default the experiment's.
    rigs : int
        Number of rigs, the configured one included.
    seed : int
        Of what is drawn for the others.
    spread : float
        How far they are from the configured one, see `perturbed_rig`.

    Raises
    ------
    InputError
        If there is no such method, a mass ratio is out of bounds, or the experiment makes no
        test with any method.
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
    GroundMotion.from_parameters(experiment["ground_motion"], axes, timebase)
    knowledge(experiment["reference_force"], axes, timebase)
    force_control(experiment["force_controller"], axes, timebase)
    for number, section in enumerate(sections):
        check_rig(section, axes, timebase, number)
    chosen = tuple(dict.fromkeys(methods or METHODS))
    tournament = Tournament(experiment, chosen, tuple(dict.fromkeys(ratios)), tuple(sections), {})
    pairs = tournament.pairs()
    for ratio, method in pairs:
        try:
            build_blocks(tournament.experiment_of(Entry(ratio, 0, method)))
        except InputError as error:  # all else is in order: the method lacks something
            tournament.not_possible[ratio, method] = str(error)
    if len(tournament.not_possible) == len(pairs):
        raise InputError(f"no method is possible: {next(iter(tournament.not_possible.values()))}")
    return tournament
