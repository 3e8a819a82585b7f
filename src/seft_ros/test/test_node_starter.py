"""The process that starts the nodes of a run, and ends those that are left behind."""

import os
import signal
import time
from pathlib import Path

import pytest
from seft_msgs_py.errors import ExperimentError
from seft_ros.test_run.node_starter import NodeStarter

SLEEPER = """
import ctypes, os, signal, sys, time

def main():
    what, log = sys.argv[1:]
    if what == "raise":
        raise ValueError("a fault of its own")
    if what == "sleep":
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
        print("asleep", hex(id(sys)), ctypes.pythonapi.Py_IsInitialized)
        sys.stdout.flush()
        time.sleep(60)
    return int(what)
"""
PATIENCE = 60.0  # s


@pytest.fixture(scope="module", autouse=True)
def sleeper(tmp_path_factory):
    """Have the module of the processes found."""
    folder = tmp_path_factory.mktemp("sleeper")
    (folder / "sleeper.py").write_text(SLEEPER)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(folder), prepend=os.pathsep)
        yield


@pytest.fixture(scope="module")
def starter(sleeper):
    """A starter for all tests that do not end it; it imports nothing, which takes long."""
    with NodeStarter(()) as found:
        yield found


@pytest.fixture
def start(tmp_path):
    """Start a process that does as it is asked, and wait until it has said so, or has ended."""

    def start(starter, what, name="log"):
        log = tmp_path / name
        node = starter.start(["sleeper", what, str(log)], log)
        message = ""
        while starter.status(node) is None and not ("asleep" in message and message.endswith("\n")):
            time.sleep(0.01)
            message = log.read_text() if log.exists() else ""  # which it may have begun to write
        return node, log

    return start


@pytest.mark.parametrize("status", [0, 3])
def test_it_knows_how_a_node_ended(start, starter, status):
    node, _ = start(starter, str(status))
    assert starter.status(node) == status


def test_a_fault_is_in_the_log(start, starter):
    node, log = start(starter, "raise")
    assert starter.status(node) == 1
    assert log.read_text().strip().endswith("ValueError: a fault of its own")


def test_a_log_that_cannot_be_made_ends_the_node(starter, tmp_path):
    node = starter.start(["sleeper", "sleep", ""], tmp_path / "missing" / "log")
    assert starter.status(node, PATIENCE) == 1


def test_a_node_ends_by_a_signal(start, starter):
    node, _ = start(starter, "sleep")
    assert starter.status(node, 0.01) is None
    starter.signal(node, signal.SIGKILL)
    assert starter.status(node, PATIENCE) == -signal.SIGKILL
    starter.signal(node, signal.SIGKILL)  # which finds none, and no other


def test_a_node_has_its_session_its_command_line_and_the_addresses_of_others(start, starter):
    (one, log), (other, its_log) = start(starter, "sleep", "1"), start(starter, "sleep", "2")
    for node, file in (one, log), (other, its_log):
        assert os.getsid(node) == node
        words = Path(f"/proc/{node}/cmdline").read_text().rstrip("\0")
        assert words.split(" ")[1:] == ["-m", "sleeper", "sleep", str(file)]
    assert log.read_text() == its_log.read_text()


def test_what_a_run_leaves_behind_ends_with_it_even_what_is_stopped(start):
    with NodeStarter(()) as starter:
        nodes = [start(starter, "sleep", name)[0] for name in ("1", "2")]
        os.kill(nodes[1], signal.SIGSTOP)
    assert not any(Path(f"/proc/{node}").exists() for node in nodes)


def test_nodes_end_with_their_starter(start, tmp_path):
    with NodeStarter(()) as starter:
        node, _ = start(starter, "sleep")
        os.kill(os.getsid(starter._process.pid), signal.SIGKILL)
        assert starter.status(node, PATIENCE) == -signal.SIGTERM
        with pytest.raises(ExperimentError, match="the process that starts the nodes has ended"):
            starter.start(["sleeper", "0", ""], tmp_path / "log")


def test_it_has_one_thread_when_it_starts_nodes(start):
    with NodeStarter() as starter:
        start(starter, "0")
        assert len(list(Path(f"/proc/{starter._process.pid}/task").iterdir())) == 1
