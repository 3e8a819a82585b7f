"""The tables of all nodes together: what is taken from where, and that none contradicts itself."""

from fnmatch import fnmatch
from pathlib import Path

import pytest
from seft_msgs_py.config.experiment import Experiment, parse_override, split_ros_arguments
from seft_msgs_py.wire.topics import NODES
from seft_plant_sim.rig_parameters import RIG_TABLE as RIG
from seft_ros.identification.rig_tests import open_loop
from seft_ros.test_run.parameter_tables import TABLES

CONFIG = Path(__file__).parents[3] / "config"
SPECIMEN = ("rig:specimen.mass:=52.7", "rig:specimen.stiffness:=2.11e5", "rig:specimen.damping:=9")
ROWS = [(table.node, row) for table in TABLES for row in table.rows.values()]


def load(*words, files=()):
    return Experiment.load(TABLES, files, [parse_override(word) for word in words])


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ((), (52.7, 52.7, 52.7)),
        (("reference_force:model.mass:=60",), (52.7, 60.0, 60.0)),
        (("ground_motion:mass:=70",), (52.7, 52.7, 70.0)),
        (("ground_motion:mass:=70", "reference_force:model.mass:=60"), (52.7, 60.0, 70.0)),
    ],
)
def test_the_mass_comes_down_from_the_specimen_over_the_model_to_the_motion(words, expected):
    experiment = load(*SPECIMEN, *words)
    assert expected == (
        experiment["rig"]["specimen.mass"],
        experiment["reference_force"]["model.mass"],
        experiment["ground_motion"]["mass"],
    )


def test_the_rig_trips_at_the_limits_of_the_supervisor_unless_it_has_its_own():
    words = (*SPECIMEN, "supervisor:limits.force:=100", "supervisor:watchdog.command_timeout:=0.5")
    rig = load(*words)["rig"]
    assert (rig["limits.force"], rig["watchdog.command_timeout"]) == (100.0, 0.5)
    assert load(*words, "rig:limits.force:=50")["rig"]["limits.force"] == 50.0


def test_there_is_a_table_for_every_node():
    assert sorted(table.node for table in TABLES) == sorted(NODES)


@pytest.mark.parametrize(("node", "row"), ROWS, ids=[f"{node} {row.name}" for node, row in ROWS])
def test_a_default_is_a_value_its_own_row_accepts(node, row):
    if row.default is not None:
        assert row.check(row.default, node) == row.default
    assert row.description
    node, _, pattern = row.default_from.partition(":")
    assert not row.default_from or any(
        fnmatch(other.name, pattern) for owner, other in ROWS if owner == node
    )


@pytest.mark.parametrize(("node", "row"), ROWS, ids=[f"{node} {row.name}" for node, row in ROWS])
def test_a_default_that_comes_from_other_parameters_comes_from_a_last_one(node, row):
    sources = {f"{owner}:{other.name}": other.default_from for owner, other in ROWS}
    passed, source = [f"{node}:{row.name}"], row.default_from
    while source and "*" not in source:
        assert source not in passed
        passed.append(source)
        source = sources[source]
    assert not any(sources[name] for name in sources if source and fnmatch(name, source))


def test_the_loop_counts_the_lag_of_the_latest_channel():
    words = (
        *SPECIMEN,
        "rig:calibration.force_lag:=0.002",
        "rig:calibration.displacement_lag:=[0.003]",
    )
    experiment = load(*words)
    assert experiment["reference_force"]["compensation.sensor_lag"] == 0.003
    assert experiment["force_controller"]["sensor_lag"] == 0.003
    told = load(*words, "reference_force:compensation.sensor_lag:=0.001")
    assert told["force_controller"]["sensor_lag"] == 0.001
    assert load(*SPECIMEN)["force_controller"]["sensor_lag"] == 0.0


@pytest.mark.parametrize("path", sorted(CONFIG.glob("*.yaml")), ids=lambda path: path.name)
@pytest.mark.parametrize("of_code", [False, True])
def test_each_node_reads_from_its_command_line_what_the_experiment_has(path, of_code):
    overrides = [parse_override("supervisor:limits.force:=20000.0")]
    experiment = Experiment.load(TABLES, [path], overrides)
    experiment = Experiment(experiment.sections) if of_code else experiment
    experiment = open_loop(experiment, Path("no_record.csv"), 0.1)
    experiment = experiment.changed({"recorder": {"name": "on"}, "rig": {"keep_awake": True}})
    words = ["--ros-args", *experiment.arguments()]
    assert (str(path) in words) is not of_code
    files, overrides, others = split_ros_arguments(words)
    assert others == ["--ros-args"]
    for table in TABLES:
        tables = [RIG] if table.node == "rig" else TABLES  # those that the node itself knows
        read = Experiment.load(tables, files, overrides, [table.node])
        assert read[table.node] == experiment[table.node]
