"""The loop's nodes in one process: the same bits, topics and safety as in several."""

import pytest
from graph_tools import (
    JHU,
    MISSES_ALLOWED,
    PATIENCE,
    STALLS_ALLOWED,
    children,
    kill,
    thorough,
    wait_for,
)
from seft_msgs_py.wire.topics import VALVE_COMMAND
from seft_ros.bags.record_bag import read_bag
from test_invariant import EXPERIMENTS, LOCKSTEP, SHORT

BARELY_AHEAD = ("-p", "ground_motion:lead:=0.05")
"""A loop in lockstep must not wait for ever for a motion that is so little ahead."""


@pytest.mark.parametrize(
    ("name", "lead"),
    [
        ("servo_hydraulic", BARELY_AHEAD),
        thorough("servo_hydraulic", ()),
        thorough("eft_ideal", ()),
        thorough("target_motion", ()),
    ],
)
def test_composed_lockstep_gives_the_bits_of_the_offline_loop(seft_json, name, lead):
    words = (JHU, *SHORT, *EXPERIMENTS[name], *lead)
    simulated = seft_json("simulate", *words, "--out", "simulated")
    seft_json("run", *words, *LOCKSTEP, "--composed", "--out", "composed")
    compared = seft_json("compare", "simulated", "composed")
    assert compared["identical"] is True
    for topic in ("ground_motion", "rig/state", "reference_force", "valve_command"):
        assert compared["topics"][topic]["samples_b"] == simulated["steps"] == 1501


def test_composed_realtime_tells_its_process_and_its_priority(seft_json, tmp_path):
    words = (JHU, *SHORT, *STALLS_ALLOWED, *MISSES_ALLOWED, "--composed", "--priority", "10")
    done = seft_json("run", *words, "--out", "bag")
    assert done["steps"] == 1501
    logs = {path.name for path in (tmp_path / "bag" / "logs").glob("r*.log")}
    assert logs == {"recorder.log", "rig_reference_force_force_controller.log"}
    parameters = read_bag(tmp_path / "bag").experiment.sections
    for node in ("rig", "reference_force", "force_controller"):
        assert parameters[node]["thread_priority"] == 10
        assert parameters[node]["lock_memory"] is True


def test_a_composed_process_that_dies_ends_the_run_with_a_readable_bag(start, tmp_path):
    process = start(
        *("seft_ros.cli.main", "run", JHU, "-p", "ground_motion:synthetic.duration:=600.0"),
        *(*STALLS_ALLOWED, *MISSES_ALLOWED, "--composed", "--out", "bag"),
        *("-p", "supervisor:watchdog.peer_timeout:=5.0"),
    )
    wait_for(lambda: (tmp_path / "bag").exists() or process.poll() is not None, "the bag")
    bag = tmp_path / "bag"
    wait_for(lambda: sum(file.stat().st_size for file in bag.glob("*.mcap")) > 200_000, "samples")
    nodes = children(process.pid)
    assert nodes["rig"] == nodes["force_controller"] != nodes["supervisor"]
    kill(nodes["rig"])
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1
    assert "node rig ended (killed by signal 9)" in errors
    assert "Traceback" not in errors
    assert len(read_bag(bag).series["rig/state"].steps) > 100


def test_a_second_publisher_of_the_command_is_seen_by_a_composed_process(start, hostile, observer):
    hostile.join(VALVE_COMMAND)
    wait_for(lambda: observer._node.count_publishers(VALVE_COMMAND.name) == 1, "the stranger")
    words = ("run", JHU, *LOCKSTEP, *SHORT, "--composed", "--out", "bag")
    process = start("seft_ros.cli.main", *words)
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode != 0
    assert "Traceback" not in errors
    assert "2 nodes publish valve_command" in errors
