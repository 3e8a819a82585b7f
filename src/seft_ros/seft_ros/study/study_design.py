"""The tests of a study: every method at every mass ratio on every drawn test."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import NamedTuple

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.parameter_table import nearest
from seft_msgs_py.errors import InputError

from seft_ros.force_controller.methods import force_control
from seft_ros.ground_motion.ground_motion_block import FILES
from seft_ros.ground_motion.record_file import files_of
from seft_ros.reference_force.compensation_methods import COMPENSATION_METHODS
from seft_ros.reference_force.reference_force_block import method_inputs
from seft_ros.reference_force.reference_force_parameters import REFERENCE_FORCE_TABLE
from seft_ros.study.drawn_tests import DrawnTests
from seft_ros.test_run.blocks import build_blocks, with_method

EVERY_METHOD = "all"


class StudyTest(NamedTuple):
    """Mass ratio, compensation method, and number of the drawn test (0: as configured)."""

    mass_ratio: float
    method: str
    number: int

    def __str__(self) -> str:
        return f"mass ratio {self.mass_ratio:g}, {self.method}, test {self.number}"


@dataclass(frozen=True)
class StudyDesign:
    """What is run.

    Attributes
    ----------
    experiment : Experiment
        As configured. Its model, controller and delay are what the methods assume in every test.
    drawn : DrawnTests
        Rigs and ground motions, the same for all methods and mass ratios.
    methods : tuple of str
        Compensation methods.
    mass_ratios : tuple of float
        Computed mass over the model's mass.
    not_possible : dict
        (mass ratio, method) -> why it can't be set up.
    """

    experiment: Experiment
    drawn: DrawnTests
    methods: tuple[str, ...]
    mass_ratios: tuple[float, ...]
    not_possible: dict[tuple[float, str], str]

    def tests(self) -> list[StudyTest]:
        """List the tests that are possible, those of one rig and mass ratio together."""
        return [
            StudyTest(ratio, method, number)
            for number in range(len(self.drawn.sections))
            for ratio in self.mass_ratios
            for method in self.methods
            if (ratio, method) not in self.not_possible
        ]

    def experiment_of(self, test: StudyTest) -> Experiment:
        """Give the complete experiment of a test."""
        own = self.experiment
        if test.method != own["reference_force"]["compensation.method"]:
            own = with_method(own, test.method)
        drawn = Experiment(own.sections | self.drawn.sections[test.number])
        return drawn.changed({"reference_force": {"mass_ratio": test.mass_ratio}})  # rig knows it

    def records(self) -> dict[str, bytes]:
        """Read the files of the ground motions."""
        motion, axes = self.experiment["ground_motion"], self.experiment.axes
        files = {file for name in FILES for file in files_of(motion[name], axes)} | {
            *self.drawn.motions
        }
        return {file: Path(file).read_bytes() for file in sorted(files)}


def design_study(
    experiment: Experiment,
    drawn: DrawnTests,
    methods: Sequence[str] = (),
    mass_ratios: Sequence[float] = (),
) -> StudyDesign:
    """Design a study.

    Parameters
    ----------
    experiment : Experiment
        As configured.
    drawn : DrawnTests
        Of this experiment.
    methods : sequence of str
        Default the experiment's own; `EVERY_METHOD` means all there are.
    mass_ratios : sequence of float
        Default the experiment's own.

    Raises
    ------
    InputError
        If a method is unknown, a mass ratio is out of bounds, or no method is possible.
    """
    own = experiment["reference_force"]
    chosen = [*(methods or [own["compensation.method"]])]
    if EVERY_METHOD in chosen:
        chosen = [*COMPENSATION_METHODS]
    for name in chosen:
        if name not in COMPENSATION_METHODS:
            raise InputError(
                f"--method {name}: must be {EVERY_METHOD} or one of "
                f"{', '.join(COMPENSATION_METHODS)}{nearest(name, COMPENSATION_METHODS)}"
            )
    ratios = [
        REFERENCE_FORCE_TABLE.check({"mass_ratio": ratio}, "--mass-ratio")["mass_ratio"]
        for ratio in mass_ratios
    ]
    # errors of the experiment itself come before those of a method
    method_inputs(own, experiment.axes, experiment.timebase)
    force_control(experiment["force_controller"], experiment.axes, experiment.timebase)
    chosen, ratios = list(dict.fromkeys(chosen)), list(dict.fromkeys(ratios or [own["mass_ratio"]]))
    design = StudyDesign(experiment, drawn, tuple(chosen), tuple(ratios), {})
    for ratio, method in product(design.mass_ratios, design.methods):
        try:
            build_blocks(design.experiment_of(StudyTest(ratio, method, 0)))
        except InputError as error:  # all else is in order: the method lacks something
            design.not_possible[ratio, method] = str(error)
    if not design.tests():
        raise InputError(next(iter(design.not_possible.values())))
    return design
