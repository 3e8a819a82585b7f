"""The tables of all nodes together: what is taken from where, and that none contradicts itself."""

from pathlib import Path

import pytest
from seft_msgs_py.config.experiment import Experiment, parse_override, split_ros_arguments
from seft_msgs_py.config.facts import FACTS, SETTINGS, fact_of, place_of
from seft_msgs_py.node.host import REALTIME_PARAMETERS
from seft_msgs_py.wire.topics import NODES
from seft_plant_sim.rig_parameters import RIG_TABLE as RIG
from seft_plant_sim.rig_parameters import common_lag
from seft_ros.identification.rig_tests import open_loop
from seft_ros.test_run.parameter_tables import TABLES

CONFIG = Path(__file__).parents[3] / "config"
SPECIMEN = ("specimen.mass:=52.7", "specimen.stiffness:=2.11e5", "specimen.damping:=9")
ROWS = [(table.node, row) for table in TABLES for row in table.rows.values()]
DECLARED = {}
for node, row in ROWS:
    DECLARED.setdefault(row.name, []).append((node, row))
OWN = {"method", *(row.name for row in REALTIME_PARAMETERS)}
"""What several nodes have each for itself."""


def load(*words, files=()):
    return Experiment.load(TABLES, files, [parse_override(word) for word in words])


def test_there_are_few_parameters():
    assert len({(place_of(row.name, node), row.name) for node, row in ROWS}) <= 228


def test_every_fact_and_setting_has_its_nodes():
    assert DECLARED.keys() >= FACTS.keys()
    for name, owner in SETTINGS.items():
        assert owner in [node for node, _ in DECLARED[name]]


def test_what_several_nodes_declare_is_a_fact_or_a_setting_and_one_for_all():
    several = {name for name, rows in DECLARED.items() if len(rows) > 1}
    assert several <= FACTS.keys() | SETTINGS.keys() | OWN
    for name in several - OWN:
        _, first = DECLARED[name][0]
        assert all(row is first for _, row in DECLARED[name])


def test_there_is_a_table_for_every_node():
    assert sorted(table.node for table in TABLES) == sorted(NODES)


@pytest.mark.parametrize(("node", "row"), ROWS, ids=[f"{node} {row.name}" for node, row in ROWS])
def test_a_default_is_a_value_its_own_row_accepts(node, row):
    if row.default is not None:
        assert row.check(row.default, node) == row.default
    assert row.description


def test_what_is_truly_so_is_what_is_known_unless_it_is_given():
    """All of what both have; a bias and a lag of a sensor are those of its calibration."""
    for name, row in RIG.rows.items():
        if fact := fact_of(name):
            value, other = (12, 16) if row.kind == "int" else (0.5, 0.25)
            value = [value] if row.kind == "floats" else value
            known = load(*SPECIMEN, f"{fact}:={value}")["rig"]
            assert known[name] == row.check(value, "")
            both = load(*SPECIMEN, f"{fact}:={value}", f"rig:{name}:={other}")["rig"]
            assert both[name] in (other, [other])
    for unknown in ((), ("actuator.valve_frequency:=0.0",)):
        assert load(*SPECIMEN, *unknown)["rig"]["simulated.actuator.valve_frequency"] == 70.0


def test_the_loop_counts_the_lag_of_the_latest_channel():
    words = ("calibration.force_lag:=0.002", "calibration.displacement_lag:=[0.003]")
    experiment = load(*SPECIMEN, *words)
    for node in ("rig", "reference_force", "force_controller"):
        assert common_lag(experiment[node]) == 0.003
    assert common_lag(load(*SPECIMEN)["reference_force"]) == 0.0


@pytest.mark.parametrize("path", sorted(CONFIG.glob("*.yaml")), ids=lambda path: path.name)
@pytest.mark.parametrize("of_code", [False, True])
def test_each_node_reads_from_its_command_line_what_the_experiment_has(path, of_code):
    overrides = [parse_override("/**:limits.force:=20000.0")]
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
