"""The rebuilt benchmark, its criteria and controllers, and seft on its plant."""

import json

import benchmark
import numpy as np
import pytest
import rths_product
from local_tools import assert_same, perform
from matplotlib.image import imread
from rths_controllers import conventional_inverse, run_benchmark, sample_controller
from rths_figures import criteria_figure, histories_figure
from rths_hardware import BenchmarkRig, nominal_rig
from rths_problem import (
    DT,
    NOISE,
    POSITION,
    PROBLEM,
    RATE,
    Motion,
    Plant,
    Structure,
    criteria,
    ground_motion,
    plant_step,
)
from rths_product import LABORATORY, hosted_blocks, run_product
from rths_tests import CRITERIA, INVERSE, SAMPLE, SEFT, Histories, Plan, assess, plan_tests
from seft_msgs_py.config.experiment import Experiment, write_parameter_file
from seft_msgs_py.config.facts import EVERY_NODE
from seft_msgs_py.errors import InputError
from seft_msgs_py.virtual import LocalGraph
from seft_plant_sim.lti import TransferFunction
from seft_plant_sim.simulated.rig import ConverterBoard
from seft_ros.drawing.style import save_figure
from seft_ros.nodes.loop_node import NODE_KINDS
from seft_ros.test_run.offline import simulate_test
from seft_ros.test_run.parameter_tables import TABLES

RECORDS = next((place for place in benchmark.PLACES if place.is_dir()), None)
NOMINAL = Plant.nominal()


def shaken(seconds=4.0):
    """A ground motion of 0.3 to 8 Hz, m/s^2."""
    time = np.arange(round(seconds * RATE)) * DT
    sweep = np.sin(2 * np.pi * (0.3 * time + 0.5 * (7.7 / seconds) * time**2))
    return 0.3 * np.sin(np.pi * time / seconds) * sweep


def criteria_of(structure, plant, controller, ground):
    moved = run_benchmark(structure, plant, controller, ground, seed=1)
    return criteria(moved.true, moved.numerical, structure.reference(ground))


# The plant


@pytest.mark.parametrize("hz", [1.0, 10.0, 30.0])
def test_the_plant_has_the_response_of_its_equations(hz):
    numerator, denominator = NOMINAL.command_to_displacement()
    z, work, steps = np.zeros(5), np.zeros((3, 5)), round(2.0 * RATE)
    command = np.sin(2 * np.pi * hz * DT * np.arange(steps))
    moved = np.empty(steps)
    for k in range(steps):
        moved[k] = z[POSITION]
        plant_step(NOMINAL, z, 1e-3 * command[k], work)
    s = 2j * np.pi * hz
    held = (1 - np.exp(-s * DT)) / (s * DT)
    exact = held * np.polyval(numerator, s) / np.polyval(denominator, s)
    wave = np.exp(-s * DT * np.arange(steps))[steps // 2 :]
    found = (moved[steps // 2 :] @ wave) / (1e-3 * command[steps // 2 :] @ wave)
    assert abs(found / exact - 1) < 2e-3


def test_perturbed_plants_are_drawn_as_the_benchmark_says():
    drawn = np.array([Plant.perturbed(number, 5) for number in range(1, 401)])
    for name, deviation in PROBLEM["standard_deviation"].items():
        place = Plant._fields.index(name)
        assert drawn[:, place].std() == pytest.approx(deviation, rel=0.15)
        assert drawn[:, place].mean() == pytest.approx(NOMINAL[place], abs=0.2 * deviation)
    assert Plant.perturbed(3, 5) == Plant.perturbed(3, 5) != Plant.perturbed(3, 6)


def test_computed_and_physical_part_are_the_whole_frame():
    plant = Plant.perturbed(1, 0)
    structure = Structure(2, plant)
    frequencies = np.linalg.eigvals(np.linalg.solve(*structure.whole[::2]))
    assert np.sort(np.sqrt(frequencies)) / 2 / np.pi == pytest.approx(
        [3.44, 15.25, 36.31], abs=0.01
    )
    for whole, computed, own in zip(
        structure.whole,
        structure.computed,
        (plant.mass, plant.damping, plant.stiffness),
        strict=True,
    ):
        assert (whole - computed)[0, 0] == pytest.approx(own)


def test_upper_floors_follow_the_first_one_as_in_the_whole_frame():
    structure, ground = Structure(4, NOMINAL), shaken()
    reference = structure.reference(ground)
    first = np.column_stack([reference[:, 0], np.gradient(reference[:, 0], DT)])
    found = structure.upper_floors(ground, first)
    assert np.abs(found - reference).max() < 1e-3 * np.abs(reference).max()


# Criteria and controllers


def test_a_delay_and_noise_are_what_the_criteria_say():
    numerical = np.cumsum(np.random.default_rng(0).standard_normal((20000, 3)), axis=0)
    late = np.concatenate([np.zeros(9), numerical[:-9, 0]])
    assert criteria(late, numerical, numerical)["J1"] == pytest.approx(9e3 * DT)
    noise = np.random.default_rng(1).standard_normal(20000)
    found = criteria(numerical[:, 0] + noise, numerical, numerical)
    share = 100 / numerical[:, 0].std()
    assert found["J2"] == found["J4"] == pytest.approx(share, rel=0.02)
    assert (
        found["J3"]
        == found["J5"]
        == pytest.approx(100 * np.abs(noise).max() / np.abs(numerical[:, 0]).max())
    )
    assert [found[f"J{number}"] for number in (6, 7, 8, 9)] == [0.0] * 4


def test_the_inverse_needs_the_right_plant_and_the_sample_controller_does_not():
    ground, known = shaken(), conventional_inverse(NOMINAL)
    right, wrong = NOMINAL, NOMINAL._replace(gain=1.05 * NOMINAL.gain)
    found = {
        (name, plant): criteria_of(Structure(1, plant), plant, controller, ground)["J2"]
        for name, controller in (("inverse", known), ("sample", sample_controller()))
        for plant in (right, wrong)
    }
    assert found["inverse", right] < 1.0
    assert 3.0 < found["inverse", wrong] < 8.0
    assert all(8.0 < found["sample", plant] < 14.0 for plant in (right, wrong))


@pytest.mark.skipif(RECORDS is None, reason="the benchmark's records are not here")
@pytest.mark.parametrize(("case", "record"), [(1, "el_centro"), (3, "morgan_hill"), (4, "kobe")])
def test_the_sample_controller_is_as_good_as_published(case, record):
    structure, ground = Structure(case, NOMINAL), ground_motion(RECORDS, record)
    moved = run_benchmark(structure, NOMINAL, sample_controller(), ground, seed=0)
    reference = structure.reference(ground)
    found = criteria(moved.measured, moved.numerical, reference)
    assert 4.5 < found["J1"] < 5.0
    assert 9.0 < found["J2"] < 11.0
    assert 26.0 < found["J4"] < 78.5
    true = criteria(moved.true, moved.numerical, reference)
    noise = 100 * NOISE["displacement"] / moved.numerical[:, 0].std()
    assert found["J2"] ** 2 - true["J2"] ** 2 == pytest.approx(noise**2, rel=0.1)


# The hardware


def test_a_command_acts_from_the_next_sample_on():
    rig, commands = BenchmarkRig(NOMINAL, seed=0), 2.0**-18 * np.arange(50.0) ** 2
    z, work, moved = np.zeros(5), np.zeros((3, 5)), []
    for before, command in zip([0.0, *commands], commands, strict=False):
        rig.read()
        rig.write(np.array([command]))
        moved.append(z[POSITION])
        plant_step(NOMINAL, z, before, work)
    assert rig.displacement.tolist() == moved
    assert moved[-1] > 1e-6


def test_the_sensors_have_the_benchmarks_noise():
    rig = BenchmarkRig(NOMINAL, seed=3)
    read = np.array([rig.read()[:, 0].copy() for _ in range(9000)])
    assert read[:, [0, 3]].std(axis=0) == pytest.approx(list(NOISE.values()), rel=0.03)
    assert np.isnan(read[:, [1, 2]]).all()


def test_the_file_simulates_the_same_plant():
    """Drive both by the same commands, up to 40 Hz; the file has numbers of four digits."""
    quiet = [("/**", f"sensors.{name}_noise", 0.0) for name in ("displacement", "force")]
    tested = Experiment.load(TABLES, [LABORATORY], quiet)
    ours, theirs = BenchmarkRig(NOMINAL, 0), ConverterBoard(tested["rig"], tested.axes)
    commands = 1e-3 * np.random.default_rng(2).standard_normal(100).repeat(50)
    shown = np.empty(len(commands))
    for k, command in enumerate(commands):
        ours.read()
        shown[k] = theirs.inputs()[0, 0]
        for rig in (ours.write, theirs.output):
            rig(np.array([command]))
    exact = np.array(ours.displacement)
    assert np.std(shown - exact) < 3e-3 * np.std(exact)


def test_the_plant_of_a_file_has_the_rate_of_the_benchmark():
    with pytest.raises(InputError, match="rate is 4000 Hz, but the plant has 4096 Hz"):
        nominal_rig({"rate": 4000.0, "seed": 1}, ("floor_1",))


# seft on it

SHORT = 14.0
"""Of the excitation of these tests, s."""


@pytest.fixture(scope="module")
def identified(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rths_product, "DURATION", SHORT)
        return rths_product.identify_servo(tmp_path_factory.mktemp("identified"), seed=1)


def test_the_servo_is_identified_on_noise(identified):
    numerator, denominator = NOMINAL.command_to_displacement()
    found = Experiment.load(TABLES, [LABORATORY, identified])["force_controller"]
    hz = np.array([0.5, 2.0, 4.0, 8.0, 16.0])
    shape = TransferFunction(
        *(tuple(found[f"actuator.response.{name}"]) for name in ("numerator", "denominator")),
        float(np.ravel(found["actuator.response.dead_time"])[0]),
    )
    exact = TransferFunction(tuple(numerator), tuple(denominator)).response(hz)
    assert np.abs(shape.response(hz) / exact - 1).max() < 0.03


@pytest.mark.parametrize("number", [0, 1])
def test_the_specimen_and_the_frame_move_as_the_whole_structure(identified, number):
    plant = Plant.perturbed(number, 0) if number else NOMINAL
    structure, ground = Structure(4, plant), shaken()
    moved = run_product(structure, plant, identified, ground, seed=2)
    assert moved.trip == ""
    found = criteria(moved.true, moved.numerical, structure.reference(ground))
    assert found["J2"] < 1.2 and found["J4"] < 1.5
    assert found["J6"] < 0.4 and found["J7"] < 0.4


def test_a_servo_that_is_faster_than_told_is_commanded_later(tmp_path):
    """The exact nominal response, which has no dead time, and a plant that is 0.7 ms faster."""
    told = dict(zip(("numerator", "denominator"), NOMINAL.command_to_displacement(), strict=True))
    leading = told["denominator"][0]
    known = {f"actuator.response.{name}": (part / leading).tolist() for name, part in told.items()}
    write_parameter_file(tmp_path / "told.yaml", {EVERY_NODE: known}, [])
    plant, ground = Plant.perturbed(1, 0), shaken(6.0)
    structure = Structure(4, plant)
    moved = run_product(structure, plant, tmp_path / "told.yaml", ground, seed=2)
    late = criteria(
        moved.true[16384:], moved.numerical[16384:], structure.reference(ground)[16384:]
    )
    assert late["J2"] < 0.6


def test_nodes_in_lockstep_move_the_plant_as_the_offline_loop_does(identified):
    words = (
        "rig:hardware:=rths_hardware:nominal_rig",
        "ground_motion:synthetic.duration:=0.5",
        "supervisor:rehearsal.duration:=0.0",
    )
    with LocalGraph(NODE_KINDS, [LABORATORY, identified], *words) as graph:
        perform(graph)
        tested = graph.experiment
        device = nominal_rig(tested["rig"], tested.axes)
        assert_same(graph, simulate_test(tested, hosted_blocks(tested, device)))


# The program


def test_tests_are_each_case_and_record_and_perturbed_plants_of_the_first_record():
    tests = plan_tests([1, 4], ["kobe", "el_centro"], 2)
    assert [(test.case, test.record, test.plant) for test in tests] == [
        *((case, record, "nominal") for case in (1, 4) for record in ("kobe", "el_centro")),
        *((case, "kobe", f"perturbed {number}") for case in (1, 4) for number in (1, 2)),
    ]


def folder_of(path, seconds=2.0):
    """A folder with a short record in place of El Centro."""
    path.mkdir()
    every = round(RATE * PROBLEM["records"]["el_centro"])
    np.savetxt(path / "el_centro.txt", shaken(seconds)[::every] / PROBLEM["scale"])
    return path


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--data", "none"], "el_centro.txt: is not there"),
        (["--data", "data", "--records", "kobe"], "kobe.txt: is not there"),
        (["--data", "data", "--records", "el_centro", "--out", "data"], "data: exists already"),
        (["--data", "data", "--perturbed", "-1"], "--perturbed and --seed"),
    ],
)
def test_wrong_input_is_one_line_before_the_work(capsys, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    folder_of(tmp_path / "data")
    assert benchmark.main(words) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and message in err
    assert [path.name for path in tmp_path.iterdir()] == ["data"]


def outcomes_of(tests, trip=""):
    """Outcomes with each controller, of motions that are the reference's, late by a sample."""
    time = DT * np.arange(round(RATE))
    reference = np.sin(2 * np.pi * 3.0 * time)[:, np.newaxis] * np.ones(3)
    late = np.roll(reference[:, 0], 1)
    moved = {name: Motion(late, late, reference) for name in (SAMPLE, INVERSE)}
    moved[SEFT] = Motion(late, late, reference, trip)
    found = [Histories(test, moved, reference) for test in tests]
    return found, [outcome for each in found for outcome in assess(each)]


def test_a_tripped_test_is_named_and_has_no_criteria():
    _, outcomes = outcomes_of(plan_tests([2], ["kobe"], 1), trip="force: beyond its limit")
    plan = Plan(benchmark.HERE, benchmark.HERE / "model.yaml", 7)
    found = json.loads(json.dumps(benchmark.summarise(outcomes, plan, 1.0), allow_nan=False))
    assert [(test["case"], test["record"], test["plant"]) for test in found["tests"]] == [
        (2, "kobe", "nominal"),
        (2, "kobe", "perturbed 1"),
    ]
    test = found["tests"][0]
    assert test["trip"] == "force: beyond its limit"
    assert test["j"] == test["true_j"] == dict.fromkeys(CRITERIA)
    assert found[SAMPLE][0]["trip"] is None
    assert 0.4 < found[SAMPLE][0]["true_j"]["J2"] < 0.5
    assert "trip" in benchmark.nominal_table(outcomes).rows[0]


def test_figures_are_drawn_of_whole_and_of_tripped_tests(tmp_path):
    for trip in ("", "force: beyond its limit"):
        histories, outcomes = outcomes_of(plan_tests([2], ["kobe"], 1), trip)
        groups = benchmark.groups_of(outcomes)
        save_figure(histories_figure(histories[0]), tmp_path / "histories.png")
        save_figure(criteria_figure(groups, benchmark.mean_and_worst), tmp_path / "criteria.png")
        assert all(imread(path).std() > 0.02 for path in tmp_path.iterdir())
