"""Runs that break: one line says why, the bag is readable, no process is left."""

import json
import os
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from graph_tools import (
    JHU,
    MISSES_ALLOWED,
    PATIENCE,
    abandoned,
    children,
    kill,
    shared_files,
    wait_for,
)
from seft_ros.recording.bag_reader import read_bag

NO_COMMAND_ALLOWED = ("-p", "supervisor:watchdog.command_timeout:=60.0")
"""In realtime, the rig waits until the supervisor has found out who is silent."""
LONG = ("-p", "ground_motion:synthetic.duration:=400.0")


@pytest.fixture
def running(start, tmp_path):
    """A `seft run` that has been under way for a while, and its node processes."""

    def launch(*words):
        words = (*LONG, *NO_COMMAND_ALLOWED, *MISSES_ALLOWED, *words)
        process = start("seft_ros.commands.main", "run", JHU, *words, "--out", "bag")
        wait_for(lambda: (tmp_path / "bag").exists(), "the bag")
        wait_for(lambda: bag_size(tmp_path / "bag") > 200_000, "some data in it")
        nodes = wait_for(lambda: children(process.pid), "the nodes")
        assert len(nodes) == 6
        return process, nodes

    return launch


def contents(bag):
    """Bytes of a bag that is being written; it is not compressed."""
    return b"".join(file.read_bytes() for file in bag.glob("*.mcap"))


def bag_size(bag):
    return sum(file.stat().st_size for file in bag.glob("*.*"))


def ending(process: subprocess.Popen, nodes: dict[str, int]) -> str:
    """Wait for the end; return what is said on stderr, which is one line."""
    _, errors = process.communicate(timeout=PATIENCE)
    assert "Traceback" not in errors
    assert not children(process.pid)
    lines = [line for line in errors.splitlines() if line.startswith("seft: ")]
    assert len(lines) == 1, errors
    return lines[0]


@pytest.mark.parametrize(
    ("node", "pace"),
    [
        *(("rig", "realtime"), ("force_controller", "realtime"), ("reference_force", "lockstep")),
        *(("ground_motion", "realtime"), ("supervisor", "lockstep"), ("supervisor", "realtime")),
    ],
)
def test_a_node_that_dies_ends_the_run_with_a_readable_bag(running, tmp_path, node, pace):
    process, nodes = running("-p", f"rig:pace:={pace}")
    memory = set().union(*map(shared_files, nodes.values()))
    assert len(memory) >= len(nodes)
    kill(nodes[node])
    line = ending(process, nodes)
    assert process.returncode == 1
    assert f"node {node} ended (killed by signal 9)" in line
    assert "(at step " in line
    record = read_bag(tmp_path / "bag")
    assert len(record.series["rig/state"].steps) > 100
    assert not abandoned(memory)
    if node == "supervisor":  # nobody but the rig itself can end its test
        assert record.trip.reason == "node supervisor has been silent for 1 s"
    if node == "ground_motion":  # the force came down while there was motion left
        force = record.series["reference_force"].values[:, 0, 0]
        assert force[-1] == 0.0
        assert "node ground_motion has been silent since" in record.trip.reason


@pytest.mark.parametrize(
    ("node", "pace"),
    [
        *(("rig", "realtime"), ("reference_force", "realtime"), ("force_controller", "lockstep")),
        *(("recorder", "lockstep"), ("supervisor", "realtime")),
    ],
)
def test_a_node_that_stands_still_is_named_with_the_time(running, tmp_path, node, pace):
    process, nodes = running("-p", f"rig:pace:={pace}")
    memory = set().union(*map(shared_files, nodes.values()))
    os.kill(nodes[node], signal.SIGSTOP)
    line = ending(process, nodes)
    assert process.returncode == 1
    assert f"node {node} has been silent " in line
    assert "(at step " in line
    record = read_bag(tmp_path / "bag")
    assert len(record.series["rig/state"].steps) > 100
    assert not abandoned(memory)


def test_a_rig_without_commands_trips_and_the_silent_node_is_found_out(running, tmp_path):
    process, nodes = running("-p", "supervisor:watchdog.command_timeout:=0.5")
    os.kill(nodes["reference_force"], signal.SIGSTOP)
    line = ending(process, nodes)
    assert process.returncode == 1
    assert "no new valve_command for 0.5 s" in line
    assert "; node reference_force has been silent since " in line
    trip = read_bag(tmp_path / "bag").trip
    assert "; node reference_force has been silent since " in trip.reason
    assert f"(at step {trip.step})" in line


def test_a_killed_recorder_loses_at_most_half_a_second(running, seft, tmp_path):
    process, nodes = running()
    kill(nodes["recorder"])
    line = ending(process, nodes)
    assert process.returncode == 1
    assert "node recorder ended (killed by signal 9)" in line
    last_step = int(line.split("at step ")[1].split(")")[0])
    refused = seft("report", "bag", status=2)
    assert "seft recover bag" in refused.stderr
    seft("recover", "bag", status=0)
    steps = read_bag(tmp_path / "bag").series["rig/state"].steps
    # the clock that dates the death is published 10 times a second
    assert steps[-1] >= last_step - 250 - 75
    assert (steps == range(len(steps))).all()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_run_comes_down_softly_and_keeps_its_bag(running, tmp_path, number):
    process, nodes = running()
    memory = set().union(*map(shared_files, nodes.values()))
    process.send_signal(number)
    assert "interrupted" in ending(process, nodes)
    assert process.returncode == 1
    record = read_bag(tmp_path / "bag")
    assert record.complete
    assert record.trip.reason == "stopped by the operator"
    assert record.series["reference_force"].values[-1, 0, 0] == 0.0
    assert not abandoned(memory)


def test_a_second_interruption_is_an_emergency_stop(running, tmp_path):
    process, nodes = running("-p", "reference_force:ramp_down_time:=60.0")
    process.send_signal(signal.SIGINT)
    wait_for(lambda: b"stopped by the operator" in contents(tmp_path / "bag"), "the ramp")
    process.send_signal(signal.SIGINT)
    ending(process, nodes)
    assert process.returncode == 1
    assert read_bag(tmp_path / "bag").trip.reason == (
        "emergency stop (while ramping down: stopped by the operator)"
    )


def test_nodes_do_not_outlive_a_killed_run(running):
    process, nodes = running()
    kill(process.pid)
    process.wait()

    def gone():
        return not any(is_alive(pid) for pid in nodes.values())

    wait_for(gone, "the nodes to end")


def is_alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("reference_force:mass_ratio:=x", "mass_ratio"),
        ("rate:=333.0", "333"),
        ("rig:specimen.mass:=0.0", "mass"),
        ("force_controller:numerator:=[1.0, 0.0, 0.0, 0.0]", "improper"),
        ("ground_motion:unit:=furlong", "furlong"),
        ("ground_motion:file:=nowhere.AT2", "nowhere.AT2"),
    ],
)
def test_wrong_input_is_told_before_any_node_starts(seft, tmp_path, override, words):
    done = seft("run", JHU, "-p", override, status=2)
    assert done.stdout == ""
    assert len(done.stderr.strip().splitlines()) == 1
    assert words in done.stderr
    assert not (tmp_path / "bags").exists()


def test_a_bag_is_not_overwritten(seft, tmp_path):
    (tmp_path / "bag").mkdir()
    done = seft("run", JHU, "--out", "bag", status=2)
    assert "exists already" in done.stderr


def test_a_second_test_on_the_same_domain_is_refused(running, seft, tmp_path):
    process, nodes = running("-p", "rig:pace:=lockstep")
    refused = seft("run", JHU, "--out", "second", status=2)
    assert "already has a node" in refused.stderr
    assert "ROS_DOMAIN_ID" in refused.stderr
    assert process.poll() is None
    process.send_signal(signal.SIGINT)
    ending(process, nodes)


def test_a_missing_peer_in_lockstep_ends_the_run_with_its_name(seft, tmp_path):
    done = seft(
        *("run", JHU, "-p", "rig:pace:=lockstep", "-p", "rig:lockstep_timeout:=1.0"),
        *("-p", "supervisor:peers:=[ground_motion, reference_force, rig, recorder]"),
        *("--out", "bag"),
        status=1,
    )
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith("seft: the test tripped: no valve_command for step 0 within 1 s")
    assert "is force_controller running?" in last
    assert len(read_bag(tmp_path / "bag").series["rig/state"].steps) == 1


def test_a_full_disk_brings_the_test_down_softly_and_the_bag_is_readable(domain, tmp_path):
    disk = tmp_path / "disk"
    disk.mkdir()
    run = [sys.executable, "-m", "seft_ros.commands.main", "run", str(JHU), *LONG]
    run += ["-p", "rig:pace:=lockstep", "--out", "bag"]
    report = [sys.executable, "-m", "seft_ros.commands.main", "report", "bag", "--out", "page.html"]
    shell = (
        f"mount -t tmpfs -o size=11m tmpfs {disk} && cd {disk} || exit 77\n"
        f"{shlex.join(run)}; echo run $?\n{shlex.join([*report, '--json'])}"
    )
    done = subprocess.run(
        ["unshare", "-m", "sh", "-c", shell], capture_output=True, text=True, timeout=PATIENCE
    )
    if done.returncode == 77 or "unshare" in done.stderr:
        pytest.skip("may not mount a file system here")
    status, summary = done.stdout.split("\n", 1)
    (line,) = [line for line in done.stderr.splitlines() if "node recorder ended" in line]
    assert status == "run 1"
    assert "the bag ends here (No space left on device)" in line
    assert "Traceback" not in done.stderr
    assert json.loads(summary)["steps"] > 1000
