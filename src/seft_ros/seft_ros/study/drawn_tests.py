"""The tests of a study: every method at every mass ratio on tests drawn at random.

Drawn is what an experimenter does not know exactly: rig, specimen, ground motion.
"""

import pickle
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import CHANNELS
from seft_msgs_py.config.parameter_table import Section, as_matrix, nearest, per_axis
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import Timebase, of_one_rig
from seft_plant_sim import rig_parameters
from seft_plant_sim.rig import Rig

from seft_ros.force_controller.methods import force_control
from seft_ros.ground_motion.ground_motion_block import FILES, GroundMotion
from seft_ros.ground_motion.record_file import files_of
from seft_ros.reference_force.compensation_methods import COMPENSATION_METHODS
from seft_ros.reference_force.reference_force_block import method_inputs
from seft_ros.reference_force.reference_force_parameters import REFERENCE_FORCE_TABLE
from seft_ros.test_run.blocks import build_blocks, with_method

DRAWN_QUANTITIES = {
    "rig:simulated.specimen.mass": 0.2,  # it is weighed
    "rig:simulated.specimen.damping": 5.0,
    "rig:simulated.specimen.stiffness": 1.0,
    "rig:simulated.specimen.yield_displacement": 1.0,
    "rig:simulated.actuator.delay": 1.0,
    "rig:simulated.actuator.oil_stiffness": 1.0,
    "rig:simulated.actuator.flow_gain": 1.0,
    "rig:simulated.actuator.leakage": 3.0,
    "rig:simulated.actuator.valve_frequency": 1.0,
    "rig:simulated.actuator.valve_damping": 1.0,
    "rig:simulated.actuator.dead_time": 1.0,
    "rig:simulated.actuator.friction": 3.0,
    "rig:simulated.specimen.friction.force": 1.0,
    "rig:simulated.specimen.gap.width": 1.0,
    "rig:simulated.specimen.gap.stiffness": 1.0,
    "rig:simulated.specimen.duffing.cubic": 1.0,
    **{f"rig:simulated.sensors.{name}_scale": 0.1 for name in CHANNELS},  # they are calibrated
    **{f"rig:simulated.sensors.{name}_filter": 0.1 for name in CHANNELS},
    "ground_motion:peak_force": 1.0,
    "ground_motion:influence": 1.0,  # in place of peak_force where the motion is as recorded
    "ground_motion:synthetic.ground_frequency": 3.0,
    "ground_motion:synthetic.ground_damping": 3.0,
}
"""How uncertain each parameter is, in units of the spread; new ones go to the end of their node."""

DRAWN_OFFSETS = {
    # s: of two filters alike, of 60 Hz, whose corners differ by a tenth of the spread
    **{f"rig:simulated.sensors.{name}_lag": 5e-4 for name in CHANNELS},
    "rig:simulated.sensors.tilt": 0.1,  # rad: between the axes of a rig
}
"""Largest addition to parameters that are zero where nothing is wrong, in units of the spread."""


_TILT = "rig:simulated.sensors.tilt"
_OF_AN_AXIS = "simulated.actuator.", "simulated.sensors."


@dataclass(frozen=True)
class DrawnTests:
    """Test 0 as configured, and N tests that differ from it at random.

    Attributes
    ----------
    sections : tuple of dict
        Of each test, the parameters of ``rig`` and ``ground_motion``.
    factors : dict
        Drawn quantity -> its values in tests 1 to N over the configured one, shape (N,). Those on
        which the simulated test does not depend are left out.
    offsets : dict
        Drawn quantity -> what is added to it in tests 1 to N, shape (N,), in its unit.
    seed, spread, motions : int, float, tuple of str
        Of `draw_tests`.
    """

    sections: tuple[dict[str, Section], ...]
    factors: dict[str, Floats]
    offsets: dict[str, Floats]
    seed: int
    spread: float
    motions: tuple[str, ...]

    def deviations(self) -> dict[str, Floats]:
        """Say how far each drawn quantity is from the configured one, either way; shape (N,)."""
        logarithms = {name: np.abs(np.log(own)) for name, own in self.factors.items()}
        return logarithms | {name: np.abs(own) for name, own in self.offsets.items()}


def draw_tests(
    experiment: Experiment,
    number: int,
    *,
    seed: int = 1,
    spread: float = 0.1,
    motions: Sequence[str] = (),
) -> DrawnTests:
    """Draw tests; each depends on the seed and its own number alone.

    Parameters
    ----------
    experiment : Experiment
        As configured.
    number : int
        How many are drawn, N.
    seed, spread : int, float
        See `drawn_rig` and `drawn_motion`; the spread is at least 0.
    motions : sequence of str
        Files, of which each test takes one at random; none: the configured motion.

    Raises
    ------
    InputError
        If a rig or a motion is impossible.
    """
    axes, timebase = experiment.axes, experiment.timebase
    own = {node: experiment[node] for node in ("rig", "ground_motion")}
    for file in [own["ground_motion"]["file"], *dict.fromkeys(motions)]:
        GroundMotion(own["ground_motion"] | {"file": file}, axes, timebase)
    check_rig(own["rig"], axes, timebase, 0)
    drawn = []
    for index in range(1, 1 + number):
        rig = drawn_rig(own["rig"], axes, seed, index, spread)
        check_rig(rig, axes, timebase, index)
        motion = drawn_motion(own["ground_motion"], seed, index, spread, motions)
        drawn.append({"rig": rig, "ground_motion": motion})
    # without spread: the configured values, for each axis where the drawn ones are
    base = own | {"rig": drawn_rig(own["rig"], axes, seed, 1, 0.0)}
    factors: dict[str, Floats] = {}
    offsets: dict[str, Floats] = {}
    for quantity in (*DRAWN_QUANTITIES, *DRAWN_OFFSETS):
        node, name = quantity.split(":")
        configured = np.ravel(base[node][name])
        values = np.array([np.ravel(one[node][name]) for one in drawn])
        for label, place in _places(base[node], quantity, axes, timebase):
            own_values = values[:, place]
            if (own_values == configured[place]).all():
                continue
            if quantity in DRAWN_OFFSETS:
                offsets[label] = own_values - configured[place]
            else:
                factors[label] = own_values / configured[place]
    return DrawnTests((own, *drawn), factors, offsets, seed, spread, tuple(motions))


def drawn_rig(
    section: Section, axes: Sequence[str], seed: int, number: int, spread: float
) -> Section:
    """Draw the parameters of the rig of a test from 1 on.

    Each parameter p of `DRAWN_QUANTITIES` becomes p (1 + uncertainty spread)^d, with its own d
    drawn uniformly between -1 and 1: with a spread of 0.2 the stiffness is up to 20 % too high or
    too low, and the damping up to twice or half. Actuators differ from axis to axis; the matrices
    of the specimen are scaled as a whole. Zero stays zero. The seed of the sensor noise is drawn
    too. To each parameter of `DRAWN_OFFSETS` its largest addition times d is added; for a lag d is
    drawn between 0 and 1.
    """
    random = np.random.default_rng([seed, number])
    drawn: Section = {"seed": int(random.integers(2**31))}
    for name, uncertainty in _of_node("rig").items():
        factors = _draw_factors(random, uncertainty, spread, len(axes))
        value, kind = section[name], rig_parameters.RIG_TABLE.rows[name].kind
        if len(axes) > 1 and kind == "floats" and name.startswith(_OF_AN_AXIS):
            drawn[name] = (per_axis(value, axes, f"rig: {name}") * factors).tolist()
        else:
            drawn[name] = np.multiply(value, float(factors[0])).tolist()
    for quantity, most in DRAWN_OFFSETS.items():
        name, several = quantity.removeprefix("rig:"), len(axes) > 1
        if quantity != _TILT:
            each = most * spread * random.uniform(0.0, 1.0, len(axes))
            value = section[name] if several else np.ravel(section[name])[0]
            drawn[name] = (value + each if several else value + each[0]).tolist()
        elif several:
            each = most * spread * random.uniform(-1.0, 1.0, (len(axes), len(axes)))
            given = np.any(section[name])
            own = as_matrix(section[name], axes, f"rig: {name}") if given else np.eye(len(axes))
            drawn[name] = (own + np.where(_neighbours(axes), each, 0.0)).ravel().tolist()
    return section | drawn


def drawn_motion(
    section: Section, seed: int, number: int, spread: float, files: Sequence[str]
) -> Section:
    """Draw the ground motion of a test from 1 on.

    One of the files, if there are any, the amplitude, and the seed and the ground layer of a
    synthetic motion.
    """
    # a child of the sequence from which the rig of this number is drawn
    (child,) = np.random.SeedSequence([seed, number]).spawn(1)
    random = np.random.default_rng(child)
    drawn: Section = {}
    if files:
        drawn["file"] = files[int(random.integers(len(files)))]
    drawn["synthetic.seed"] = int(random.integers(2**31))
    amplitude = "peak_force" if section["peak_force"] else "influence"
    synthetic = not (files or files_of(section["file"], ()))
    for name, uncertainty in _of_node("ground_motion").items():
        by = float(_draw_factors(random, uncertainty, spread, 1)[0])
        if name == amplitude or (synthetic and name.startswith("synthetic.")):
            drawn[name] = np.multiply(section[name], by).tolist()
    return section | drawn


def check_rig(section: Section, axes: tuple[str, ...], timebase: Timebase, number: int) -> None:
    """Refuse impossible parameters; the InputError names the test's number if it is not 0."""
    try:
        Rig(rig_parameters.RIG_TABLE.check(section), axes, timebase)
    except InputError as error:
        if number == 0:
            raise
        why = f"{error}; a smaller spread keeps rigs possible"
        raise InputError(f"drawn test {number}: {why}") from None


def _of_node(node: str) -> dict[str, float]:
    """Uncertainties of a node's parameters, by their names there."""
    split = ((quantity.split(":"), value) for quantity, value in DRAWN_QUANTITIES.items())
    return {name: value for (place, name), value in split if place == node}


def _draw_factors(random: np.random.Generator, uncertainty: float, spread: float, n: int) -> Floats:
    """Draw n factors between 1 / most and most = 1 + uncertainty * spread, as likely up as down."""
    return (1.0 + uncertainty * spread) ** random.uniform(-1.0, 1.0, n)


def _neighbours(axes: Sequence[str]) -> npt.NDArray[np.bool_]:
    """Say which pairs of different axes belong to one rig, shape (n, n)."""
    return of_one_rig(axes) & ~np.eye(len(axes), dtype=bool)


def _matters(
    base: Section, name: str, value: Floats, axes: tuple[str, ...], timebase: Timebase
) -> bool:
    """Whether the simulated rig is another one with this value of a parameter."""
    one, other = (
        pickle.dumps(Rig(section, axes, timebase).simulation.parameters)
        for section in (base, base | {name: value.tolist()})
    )
    return one != other


def _places(
    base: Section, quantity: str, axes: tuple[str, ...], timebase: Timebase
) -> list[tuple[str, int]]:
    """Labels and places of the values of a parameter on which the simulated test depends."""
    node, name = quantity.split(":")
    values, several = np.ravel(base[name]), len(axes) > 1
    largest = [(quantity, int(np.abs(values).argmax()))]
    if node != "rig":
        return largest
    if quantity == _TILT:
        pairs = np.argwhere(_neighbours(axes)).tolist()
        return [(f"{quantity}, axis {axes[i]} by {axes[j]}", i * len(axes) + j) for i, j in pairs]
    added = DRAWN_OFFSETS.get(quantity, 0.0)
    other = np.add(base[name], added) if added else np.multiply(base[name], 1.01)
    if not _matters(base, name, other, axes, timebase):
        return []
    if not (several and name.startswith(_OF_AN_AXIS) and len(values) == len(axes)):
        return largest
    return [(f"{quantity}, axis {axis}", n) for n, axis in enumerate(axes) if added or values[n]]


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
        files = {file for name in FILES for file in files_of(motion[name], axes)}
        return {name: Path(name).read_bytes() for name in sorted(files.union(self.drawn.motions))}


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
    own, known = experiment["reference_force"], COMPENSATION_METHODS
    chosen = [*(known if EVERY_METHOD in methods else methods or [own["compensation.method"]])]
    for name in chosen:
        if name not in known:
            raise InputError(
                f"--method {name}: must be {EVERY_METHOD} or one of "
                f"{', '.join(known)}{nearest(name, known)}"
            )
    check = REFERENCE_FORCE_TABLE.rows["mass_ratio"].check
    ratios = [check(ratio, "--mass-ratio") for ratio in mass_ratios]
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
