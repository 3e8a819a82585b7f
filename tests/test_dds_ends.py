"""How a `seft run` ends: by signals, and by the death of its nodes; nothing is left.

Nodes that die or stand still at any moment, and bags without room: test_local_faults.py,
test_local_recorder.py, test_bags_bag_writer.py.
"""

import fcntl
import json
import os
import pty
import signal
import termios
from pathlib import Path

import pytest
from graph_tools import (
    JHU,
    MISSES_ALLOWED,
    PATIENCE,
    STALLS_ALLOWED,
    THOROUGH,
    children,
    hear_hang_ups,
    shared_memory,
    wait_for,
)
from seft_ros.bags.bag_writer import CHUNK
from seft_ros.bags.recording_bag import read_bag
from seft_ros.test_run.run import Interruption

LONG = ("-p", "ground_motion:synthetic.duration:=1000.0")
LOCKSTEP = ("-p", "rig:pace:=lockstep", "-p", "rig:lockstep_timeout:=60.0")
LONG_RAMP = ("-p", "reference_force:ramp_down_time:=60.0")
FEW_SECONDS = ("-p", "supervisor:watchdog.peer_timeout:=5.0")  # beyond what a busy host stalls
STOPPED = b"stopped by the operator"


class Run:
    """A `seft run` under way, in lockstep.

    Attributes
    ----------
    process : subprocess.Popen
        It.
    nodes : dict of str to int
        Its node processes.
    """

    def __init__(self, start, folder, *words, **options):
        self._bag = folder / "bag"
        words = (*LONG, *LOCKSTEP, *STALLS_ALLOWED, *words)
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
        """Wait until a chunk of the bag is whole, also if the next one is being written."""
        size = lambda: sum(file.stat().st_size for file in self._bag.glob("*.mcap"))  # noqa: E731
        wait_for(
            lambda: size() > 2 * CHUNK or self.process.poll() is not None, "some data in the bag"
        )
        self.wait_for_nodes()

    def wait_for_ramp(self):
        """Interrupt it, and wait until the bag tells that the force comes down."""
        self.process.send_signal(signal.SIGINT)
        files = lambda: (file.read_bytes() for file in self._bag.glob("*.mcap"))  # noqa: E731
        wait_for(lambda: STOPPED in b"".join(files()), "the ramp")

    def shown(self):
        """Wait for its end after a stop, which leaves nothing; give what it shows of the test."""
        shown, errors = self.process.communicate(timeout=PATIENCE)
        assert self.process.returncode == 0, errors
        self.assert_nothing_is_left()
        return shown

    def ending(self):
        """Wait for its end, which leaves nothing; give what it says on stderr, one line."""
        _, errors = self.process.communicate(timeout=PATIENCE)
        assert self.process.returncode == 1
        assert "Traceback" not in errors
        self.assert_nothing_is_left()
        (line,) = [line for line in errors.splitlines() if line.startswith("seft: ")]
        return line

    def assert_nothing_is_left(self):
        """Check that no node runs any more."""
        assert len(self.nodes) == 6
        assert not [pid for pid in self.nodes.values() if is_alive(pid)]


@pytest.fixture
def run(compiled, start, tmp_path):
    """Start a `seft run`."""
    compiled(JHU)
    return lambda *words, **options: Run(start, tmp_path, *words, **options)


def is_alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def recorded(folder):
    """Read the bag of a test that broke under way; its states are all there."""
    recording = read_bag(folder / "bag")
    steps = recording.series["rig/state"].steps
    assert len(steps) > 10
    assert (steps == range(len(steps))).all()
    return recording


def assert_came_down_softly(folder):
    recording = recorded(folder)
    assert recording.complete
    assert (recording.stopped, recording.trip) == (True, None)
    assert recording.series["reference_force"].values[-1, 0, 0] == 0.0


def test_an_interrupted_run_comes_down_softly_and_is_a_stop(run, seft_json, tmp_path):
    found = run("--json")
    found.wait_for_data()
    found.process.send_signal(signal.SIGINT)
    shown = json.loads(found.shown())
    reported = seft_json("report", "bag", status=0)
    for summary in (shown, reported):
        assert (summary["stopped"], summary["trip"], summary["stable"]) == (True, None, True)
        assert summary["judged_steps"] < summary["steps"]
    assert_came_down_softly(tmp_path)


def test_a_killed_node_is_named_and_the_bag_of_a_killed_recorder_recovered(run, seft, tmp_path):
    found = run(*FEW_SECONDS)
    found.wait_for_data()
    os.kill(found.nodes["recorder"], signal.SIGKILL)
    line = found.ending()
    assert "node recorder ended (killed by signal 9)" in line
    assert "(at step " in line
    assert "the bag is damaged" in seft("report", "bag", status=1).stdout
    seft("recover", "bag", status=0)
    assert not recorded(tmp_path).complete


def test_a_killed_run_leaves_nothing_though_one_node_is_stopped(run, seft, tmp_path):
    found = run()
    found.wait_for_data()
    os.kill(found.nodes["ground_motion"], signal.SIGSTOP)
    ours = (found.process.pid, *found.nodes.values())
    assert not [file for pid in ours for file in shared_memory(pid)]  # which nobody would remove
    os.kill(found.process.pid, signal.SIGKILL)
    found.process.wait()
    wait_for(lambda: not any(map(is_alive, found.nodes.values())), "the nodes to end")
    recorded(tmp_path)
    assert "no supervisor is in ROS domain" in seft("status", status=1).stderr


@THOROUGH
def test_a_node_that_stands_still_before_the_test_is_named(run, tmp_path):
    found = run()
    found.wait_for_nodes()
    os.kill(found.nodes["force_controller"], signal.SIGSTOP)
    assert "node force_controller stands still before the test" in found.ending()
    assert not (tmp_path / "bag").exists()


@THOROUGH
def test_a_second_interruption_is_an_abort(run, tmp_path):
    """SIGTERM is one as Ctrl-C is; in realtime the ramp takes its time."""
    found = run(*LONG_RAMP, "-p", "rig:pace:=realtime", *MISSES_ALLOWED)
    found.wait_for_data()
    found.wait_for_ramp()
    found.process.send_signal(signal.SIGTERM)
    assert "interrupted" in found.ending()
    assert recorded(tmp_path).trip.reason == (
        "aborted by the operator (while ramping down: stopped by the operator)"
    )


def test_the_third_signal_acts_at_once():
    with Interruption() as interruption:
        for _ in range(2):
            signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
        with pytest.raises(KeyboardInterrupt):
            interruption.check()


@THOROUGH
def test_a_run_whose_terminal_is_closed_comes_down_softly(run, tmp_path):
    keyboard, terminal = pty.openpty()

    def take_terminal():
        hear_hang_ups()
        fcntl.ioctl(terminal, termios.TIOCSCTTY, 0)

    options = {"stderr": terminal, "start_new_session": True, "preexec_fn": take_terminal}
    found = run(**options)
    os.close(terminal)
    found.wait_for_data()
    os.close(keyboard)
    assert found.process.wait(PATIENCE) == 0
    found.assert_nothing_is_left()
    assert_came_down_softly(tmp_path)
