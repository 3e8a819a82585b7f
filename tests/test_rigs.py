"""Several rigs in one test: each in its namespace, and one computed structure that joins them."""

import json

import numpy as np
import pytest
from graph_tools import (
    MISSES_ALLOWED,
    PATIENCE,
    ROOT,
    STALLS_ALLOWED,
    children,
    kill,
    thorough,
    wait_for,
)
from seft_msgs_py.wire.topics import RIG_STATE, VALVE_COMMAND, rigs_of
from seft_msgs_py.wire.trajectory import parse_trajectory
from seft_ros.bags.record_bag import read_bag, read_messages
from seft_ros.test_run.processes import COMPOSED, MODULES
from two_hosts import two_hosts

__all__ = ["two_hosts"]

BRIDGE = ROOT / "config" / "two_pier_bridge.yaml"
WEST, EAST = rigs_of(["west/pier", "east/pier"])
SHORT = ("-p", "ground_motion:synthetic.duration:=6.0", "-p", "ground_motion:tail:=0.5")
LINK = ("-p", "reference_force:loop_delay:=5")


@pytest.mark.parametrize(
    ("plan", "arrangement"),
    [(LINK, ("--composed",)), thorough(LINK, ()), thorough((), ("--composed",))],
)
def test_the_bits_are_those_of_the_offline_loop(seft_json, plan, arrangement):
    seft_json("simulate", BRIDGE, *SHORT, *plan, "--out", "simulated")
    words = (*SHORT, *plan, "-p", "rig:pace:=lockstep", *STALLS_ALLOWED)
    seft_json("run", BRIDGE, *words, *arrangement, "--out", "lockstep")
    assert seft_json("compare", "simulated", "lockstep")["identical"] is True


def test_a_rig_that_is_lost_brings_the_other_to_rest(start, observer, tmp_path):
    sharp = (
        *("-p", "reference_force:watchdog.rig_timeout:=1.0"),
        *("-p", "supervisor:watchdog.peer_timeout:=15.0"),  # beyond what a busy host stalls
    )
    words = (*STALLS_ALLOWED, *MISSES_ALLOWED, *sharp, "--out", "bag")
    run = start("seft_ros.cli.main", "run", BRIDGE, *words)
    bag = tmp_path / "bag"

    def is_under_way():
        assert run.poll() is None, run.communicate()
        observer.spin(0.01)
        return observer.time_ns > 1e9

    wait_for(is_under_way, "the test to be under way")
    kill(children(run.pid)["west/rig"])
    _, told = run.communicate(timeout=PATIENCE)
    assert run.returncode == 1
    assert "west/rig ended (killed by signal 9)" in told
    record = read_bag(bag)
    assert "no rig/state of west for 1 s" in record.trip.reason
    assert not record.complete  # west could not say how it ended
    states, commands = RIG_STATE.of(EAST), VALVE_COMMAND.of(EAST)
    told = [event for event in record.events if event.source == "east/rig"]
    assert any("tripped" in event.text for event in told)
    last = {}
    for topic, _, raw in read_messages(bag, [RIG_STATE.of(WEST), states, commands]):
        last[topic.name] = parse_trajectory(raw).stamp_ns
    ahead = (last[states.name] - last[RIG_STATE.of(WEST).name]) / 1e9
    assert 0.0 <= ahead < 0.1  # it waited for the other's, and stopped


def test_a_node_must_say_which_rig_s_it_is(start):
    for words, fault in (
        ((), "name its rig: --ros-args -r __ns:=/west or -r __ns:=/east"),
        (("-r", "__ns:=/lab"), "in namespace /lab, but the axes"),
    ):
        ros = ("--ros-args", "--params-file", BRIDGE, *words)
        node = start(MODULES["rig"], *ros)
        _, told = node.communicate(timeout=PATIENCE)
        assert node.returncode == 2
        assert fault in told
        assert "Traceback" not in told
    node = start(MODULES["supervisor"], "--ros-args", "--params-file", BRIDGE, "-r", "__ns:=/east")
    _, told = node.communicate(timeout=PATIENCE)
    assert node.returncode == 2
    assert "supervisor serves all rigs and can't be in /east" in told


@pytest.fixture
def east_on_b(two_hosts):
    """Start the east rig's nodes on host b, and `seft run` for all else on a; gives both."""

    def launch(*words):
        ros = ("--ros-args", "--params-file", BRIDGE, *words, "-r", "__ns:=/east")
        nodes = ("--nodes", "rig", "force_controller")
        east = two_hosts.start("b", COMPOSED, *nodes, *ros, prompt=True)
        external = ("--external", "east/rig", "--external", "east/force_controller")
        run = two_hosts.start(
            *("a", "seft_ros.cli.main", "run", BRIDGE, *external, *words),
            *("--composed", "--out", "hosts", "--json"),
            prompt=True,
        )
        return east, run

    return launch


LINKED = (
    *("-p", "/**:rate:=250.0"),  # two cores for seven nodes
    *("-p", "reference_force:loop_delay:=5"),
    *("-p", "reference_force:watchdog.rig_timeout:=10.0"),
    *SHORT,
    *STALLS_ALLOWED,
    *MISSES_ALLOWED,
)


@pytest.mark.alone
def test_rigs_on_two_hosts_move_one_structure(two_hosts, east_on_b):
    two_hosts.link(delay=0.005, jitter=0.001)
    _, run = east_on_b(*LINKED)
    out, told = run.communicate(timeout=PATIENCE)
    assert run.returncode == 0, told
    over = json.loads(out)
    assert over["trip"] is None
    assert over["steps"] == 876
    # else this machine itself stood still
    if over["missed"] + over["link"]["late"] < 0.02 * over["steps"]:
        assert over["displacement"]["nrmse"] < 0.15  # offline 0.087: the model is of 500 Hz
    record = read_bag(two_hosts.folder / "hosts")
    assert np.abs(record.series["rig/state"].values[:, 3]).max(axis=0).min() > 100.0  # both, N


def test_a_rig_lost_on_another_host_brings_all_to_rest(two_hosts, east_on_b):
    two_hosts.link(delay=0.002)
    timeouts = (
        *("-p", "reference_force:watchdog.rig_timeout:=1.0"),
        *("-p", "supervisor:watchdog.peer_timeout:=15.0"),  # beyond what a busy host stalls
    )
    east, run = east_on_b(*LINKED, *timeouts)
    bag = two_hosts.folder / "hosts"
    wait_for(lambda: list(bag.glob("*.mcap")), "the bag")
    east.kill()
    _, told = run.communicate(timeout=PATIENCE)
    assert run.returncode == 1
    assert "no rig/state of east for 1 s" in told
    record = read_bag(bag)
    told = [event for event in record.events if event.source == "west/rig"]
    assert any("tripped" in event.text for event in told)
