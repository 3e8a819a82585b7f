"""Runs that break: one line says why, the bag is readable, no process is left."""

import fcntl
import json
import os
import pty
import shlex
import shutil
import signal
import subprocess
import sys
import termios
import time
from pathlib import Path

import pytest
from graph_tools import (
    JHU,
    MISSES_ALLOWED,
    PATIENCE,
    STALLS_ALLOWED,
    children,
    kill,
    shared_memory,
    thorough,
    thorough_but,
    wait_for,
)
from seft_ros.bags.record_bag import read_bag
from seft_ros.cli.main import main
from seft_ros.test_run.processes import MODULES

NO_COMMAND_ALLOWED = ("-p", "supervisor:watchdog.command_timeout:=60.0")
"""In realtime, the rig waits until the supervisor has found out who is silent."""
UNREHEARSED = ("-p", "supervisor:rehearsal.duration:=0.0")
"""A busy machine must not refuse a test."""
LONG = ("-p", "ground_motion:synthetic.duration:=400.0")
LONG_RAMP = ("-p", "reference_force:ramp_down_time:=60.0")
STOPPED = b"stopped by the operator"


class Run:
    """A `seft run` under way.

    Attributes
    ----------
    process : subprocess.Popen
        It.
    nodes : dict of str to int
        Its node processes.
    """

    def __init__(self, start, folder, *words, **options):
        self._bag = folder / "bag"
        words = (*LONG, *NO_COMMAND_ALLOWED, *UNREHEARSED, *MISSES_ALLOWED, *words)
        words = ("seft_ros.cli.main", "run", JHU, *words, "--out", "bag")
        self.process = start(*words, **options)
        self.nodes = {}

    def wait_for_nodes(self):
        """Wait until all its processes are there."""

        def all_there():
            self.nodes = children(self.process.pid)
            return len(self.nodes) == 6

        wait_for(all_there, "the nodes")

    def wait_for_data(self):
        """Wait until it has been recording for a while."""
        wait_for(self._bag.exists, "the bag")
        size = lambda: sum(file.stat().st_size for file in self._bag.glob("*.*"))  # noqa: E731
        wait_for(lambda: size() > 60_000, "some data in it")
        self.wait_for_nodes()

    def wait_for_ramp(self):
        """Interrupt it, and wait until the bag tells that the force comes down."""
        self.process.send_signal(signal.SIGINT)
        files = lambda: (file.read_bytes() for file in self._bag.glob("*.mcap"))  # noqa: E731
        wait_for(lambda: STOPPED in b"".join(files()), "the ramp")

    def ending(self):
        """Wait for its end, which leaves nothing; give what it says on stderr, one line."""
        _, errors = self.process.communicate(timeout=PATIENCE)
        assert "Traceback" not in errors
        assert not [pid for pid in self.nodes.values() if is_alive(pid)]
        lines = [line for line in errors.splitlines() if line.startswith("seft: ")]
        assert len(lines) == 1, errors
        return lines[0]


@pytest.fixture
def run(start, tmp_path):
    """Start a `seft run`."""
    return lambda *words, **options: Run(start, tmp_path, *words, **options)


def is_alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def recorded(folder):
    """Read the bag of a test that broke under way; its states are all there."""
    record = read_bag(folder / "bag")
    steps = record.series["rig/state"].steps
    assert len(steps) > 10
    assert (steps == range(len(steps))).all()
    return record


@pytest.mark.parametrize(
    "node", thorough_but(sorted(MODULES), ["force_controller", "ground_motion"])
)
def test_a_node_that_dies_or_stands_still_before_the_test_is_named(run, tmp_path, node):
    """Half of them die, when they have just been started; half stand still."""
    dies = sorted(MODULES).index(node) % 2 == 0
    found = run()
    found.wait_for_nodes()
    os.kill(found.nodes[node], signal.SIGKILL if dies else signal.SIGSTOP)
    line = found.ending()
    assert found.process.returncode == 1
    how = "ended (killed by signal 9)" if dies else "stands still before the test"
    assert f"node {node} {how}" in line
    assert not (tmp_path / "bag").exists()


@pytest.mark.parametrize(
    ("node", "pace"),
    [
        ("force_controller", "realtime"),
        ("supervisor", "lockstep"),
        ("ground_motion", "realtime"),
        thorough("rig", "realtime"),
        thorough("reference_force", "lockstep"),
        thorough("supervisor", "realtime"),
    ],
)
def test_a_node_that_dies_ends_the_run_with_a_readable_bag(run, tmp_path, node, pace):
    found = run("-p", f"rig:pace:={pace}")
    found.wait_for_data()
    kill(found.nodes[node])
    line = found.ending()
    assert found.process.returncode == 1
    assert f"node {node} ended (killed by signal 9)" in line
    assert "(at step " in line
    record = recorded(tmp_path)
    if node == "supervisor":  # nobody but the rig itself can end its test
        assert record.trip.reason == "node supervisor has been silent for 1 s"
    if node == "ground_motion":  # the force came down while there was motion left
        force = record.series["reference_force"].values[:, 0, 0]
        assert force[-1] == 0.0
        assert "node ground_motion has been silent since" in record.trip.reason


@pytest.mark.parametrize(
    ("node", "pace"),
    [
        ("rig", "realtime"),
        ("recorder", "lockstep"),
        thorough("force_controller", "lockstep"),
        thorough("supervisor", "realtime"),
    ],
)
def test_a_node_that_stands_still_is_named_with_the_time(run, tmp_path, node, pace):
    found = run("-p", f"rig:pace:={pace}")
    found.wait_for_data()
    os.kill(found.nodes[node], signal.SIGSTOP)
    line = found.ending()
    assert found.process.returncode == 1
    assert f"node {node} has been silent " in line
    assert "(at step " in line
    recorded(tmp_path)


@pytest.mark.parametrize("node", thorough_but(sorted(MODULES), ["rig", "recorder"]))
def test_a_node_that_fails_while_the_force_comes_down_ends_the_run(run, seft, tmp_path, node):
    """Those that stood still in the test before die here, and the other way round."""
    dies = node in ("rig", "force_controller", "recorder")
    found = run(*LONG_RAMP, "-p", "rig:pace:=lockstep")
    found.wait_for_data()
    found.wait_for_ramp()
    os.kill(found.nodes[node], signal.SIGKILL if dies else signal.SIGSTOP)
    # without one of these there is no ramp any more; else the operator asks once more
    if node in ("ground_motion", "recorder"):
        found.process.send_signal(signal.SIGINT)
    assert "interrupted" in found.ending()
    assert found.process.returncode == 1
    if (dies, node) == (True, "recorder"):
        assert "the bag is damaged" in seft("report", "bag", status=1).stdout
        seft("recover", "bag", status=0)
        recorded(tmp_path)
        return
    record = recorded(tmp_path)
    if node != "supervisor":
        assert "stopped by the operator" in record.trip.reason
    if node in ("rig", "force_controller", "reference_force"):
        assert f"node {node} has been silent since" in record.trip.reason


def test_a_rig_without_commands_trips_and_the_silent_node_is_found_out(run, tmp_path):
    found = run("-p", "supervisor:watchdog.command_timeout:=0.5")
    found.wait_for_data()
    os.kill(found.nodes["reference_force"], signal.SIGSTOP)
    line = found.ending()
    assert found.process.returncode == 1
    # a busy host may have stood still meanwhile: the rig tells that instead
    waited = "no new valve_command for 0.5 s", "(0.5 s without a new valve_command are allowed)"
    assert any(words in line for words in waited)
    assert "; node reference_force has been silent since " in line
    trip = recorded(tmp_path).trip
    assert "; node reference_force has been silent since " in trip.reason
    assert f"(at step {trip.step})" in line


def test_a_killed_recorder_loses_at_most_half_a_second(run, seft, tmp_path):
    found = run()
    found.wait_for_data()
    kill(found.nodes["recorder"])
    line = found.ending()
    assert found.process.returncode == 1
    assert "node recorder ended (killed by signal 9)" in line
    last_step = int(line.split("at step ")[1].split(")")[0])
    assert "cut off" in seft("report", "bag", status=1).stdout
    assert "seft recover bag" in seft("replay", "bag", status=2).stderr
    seft("recover", "bag", status=0)
    # the clock that dates the death is published 10 times a second
    assert recorded(tmp_path).series["rig/state"].steps[-1] >= last_step - 250 - 75


def test_an_interrupted_run_comes_down_softly_and_keeps_its_bag(run, seft, tmp_path):
    """Before that, a second test on the same domain is refused.

    In realtime: in lockstep the test may be over before the second one is refused.
    """
    found = run(*STALLS_ALLOWED, *MISSES_ALLOWED)
    found.wait_for_data()
    refused = seft("run", JHU, "--out", "second", status=2)
    assert "already has a node" in refused.stderr
    assert "ROS_DOMAIN_ID" in refused.stderr
    assert found.process.poll() is None
    found.process.send_signal(signal.SIGINT)
    assert "interrupted" in found.ending()
    assert found.process.returncode == 1
    record = recorded(tmp_path)
    assert record.complete
    assert record.trip.reason == "stopped by the operator"
    assert record.series["reference_force"].values[-1, 0, 0] == 0.0


def test_in_lockstep_the_rig_waits_for_a_recorder_that_stands_still(run, tmp_path):
    found = run("-p", "rig:pace:=lockstep", "-p", "supervisor:watchdog.peer_timeout:=60.0")
    found.wait_for_data()
    os.kill(found.nodes["recorder"], signal.SIGSTOP)
    time.sleep(4.0)  # in which the rig would take twice the steps that queues hold
    os.kill(found.nodes["recorder"], signal.SIGCONT)
    found.process.send_signal(signal.SIGINT)
    found.ending()
    record = recorded(tmp_path)
    for topic in ("reference_force", "valve_command"):
        assert len(record.series[topic].steps) >= len(record.series["rig/state"].steps) - 1


def test_a_second_interruption_is_an_abort(run, tmp_path):
    """SIGTERM is one as Ctrl-C is."""
    found = run(*LONG_RAMP, *STALLS_ALLOWED)
    found.wait_for_data()
    found.wait_for_ramp()
    found.process.send_signal(signal.SIGTERM)
    assert "interrupted" in found.ending()
    assert found.process.returncode == 1
    assert recorded(tmp_path).trip.reason == (
        "aborted by the operator (while ramping down: stopped by the operator)"
    )


def test_a_run_whose_terminal_is_closed_comes_down_softly(run, tmp_path):
    keyboard, terminal = pty.openpty()

    def take_terminal():
        fcntl.ioctl(terminal, termios.TIOCSCTTY, 0)

    options = {"stderr": terminal, "start_new_session": True, "preexec_fn": take_terminal}
    found = run(*STALLS_ALLOWED, **options)
    os.close(terminal)
    found.wait_for_data()
    os.close(keyboard)
    assert found.process.wait(PATIENCE) == 1
    assert not [pid for pid in found.nodes.values() if is_alive(pid)]
    record = recorded(tmp_path)
    assert record.complete
    assert record.trip.reason == "stopped by the operator"


def test_a_killed_run_leaves_nothing_though_one_node_is_stopped(run, tmp_path):
    found = run()
    found.wait_for_data()
    os.kill(found.nodes["ground_motion"], signal.SIGSTOP)
    ours = (found.process.pid, *found.nodes.values())
    assert not [file for pid in ours for file in shared_memory(pid)]  # which nobody would remove
    kill(found.process.pid)
    found.process.wait()
    wait_for(lambda: not any(map(is_alive, found.nodes.values())), "the nodes to end")
    recorded(tmp_path)


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
def test_wrong_input_is_told_before_any_node_starts(told_at_once, tmp_path, override, words):
    assert words in told_at_once("-p", override)
    assert not (tmp_path / "bags").exists()


def test_a_bag_is_not_overwritten(told_at_once, tmp_path):
    (tmp_path / "bag").mkdir()
    assert "exists already" in told_at_once("--out", "bag")


@pytest.fixture
def told_at_once(monkeypatch, capfd, tmp_path):
    """Give the one line with which `seft run` refuses before it looks for other tests."""

    def refuse(*words):
        def never(*_, **__):
            raise AssertionError("the run went on")

        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr("seft_ros.test_run.run.Observer", never)
        monkeypatch.setattr(sys, "argv", ["seft", "run", str(JHU), *words])
        assert main() == 2
        out, errors = capfd.readouterr()
        assert out == ""
        (line,) = errors.strip().splitlines()
        return line

    return refuse


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


def test_a_disk_that_fills_up_brings_the_test_down_softly_and_all_is_recorded(domain, tmp_path):
    disk = tmp_path / "disk"
    disk.mkdir()
    run = [sys.executable, "-m", "seft_ros.cli.main", "run", str(JHU), *LONG]
    run += [*STALLS_ALLOWED, *MISSES_ALLOWED, "--out", "bag"]
    report = [sys.executable, "-m", "seft_ros.cli.main", "report", "bag", "--out", "page.html"]
    shell = (
        f"mount -t tmpfs -o size=60m tmpfs {disk} && cd {disk} || exit 77\n"
        f"{shlex.join(run)} & pid=$!\n"
        "until [ $(cat bag/bag.mcap 2> /dev/null | wc -c) -gt 60000 ]; do sleep 0.1; done\n"
        "cat /dev/zero > filler 2> /dev/null; wait $pid; echo run $?; rm filler\n"
        f"{shlex.join([*report, '--json'])}"
    )
    done = subprocess.run(
        ["unshare", "-m", "sh", "-c", shell], capture_output=True, text=True, timeout=PATIENCE
    )
    if done.returncode == 77 or "unshare" in done.stderr:
        pytest.skip("may not mount a file system here")
    _, summary = done.stdout.split("run 1\n")
    assert "Traceback" not in done.stderr
    found = json.loads(summary)
    assert found["steps"] > 100
    reason = found["trip"]["reason"]
    assert reason.startswith("the recorder's bag is lost: ")
    assert "No space left" in reason
    assert f"seft: the test tripped: {reason}" in done.stderr


@pytest.mark.parametrize("on_loss", ["stop", thorough("go_on")])
def test_the_bag_of_a_test_under_way_is_deleted_and_nothing_is_lost(run, tmp_path, on_loss):
    found = run(*STALLS_ALLOWED, *MISSES_ALLOWED, "-p", f"recorder:on_loss:={on_loss}")
    found.wait_for_data()
    shutil.rmtree(tmp_path / "bag")
    if on_loss == "go_on":
        time.sleep(3.0)  # the test goes on all the while
        found.process.send_signal(signal.SIGINT)
    line = found.ending()
    record = recorded(tmp_path)
    assert record.complete
    if on_loss == "stop":
        assert line == f"seft: the test tripped: {record.trip.reason}"
        assert record.trip.reason.endswith("bag: the bag was deleted")
    else:
        assert record.trip.reason == "stopped by the operator"
        assert len(record.series["rig/state"].steps) > 1500
    assert record.series["reference_force"].values[-1, 0, 0] == 0.0  # the ramp, too


def test_no_test_begins_that_cannot_be_recorded(told_at_once, tmp_path):
    (tmp_path / "bags").write_text("")
    line = told_at_once("--out", "bags/bag")
    assert line.startswith(f"seft: nothing can be written in {tmp_path / 'bags'} (Not a directory)")
    assert "without a path" in told_at_once("-p", "recorder:name:=../bag")
    assert "must not begin with -" in told_at_once("--out", "./-bag")
