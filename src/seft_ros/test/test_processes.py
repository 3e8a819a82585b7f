"""Where the processes of a test run."""

import os
import subprocess
from pathlib import Path

import pytest
from seft_msgs_py.node.realtime import FIRST
from seft_ros.test_run.processes import LOOP_NODES, NodeProcesses, ProcessLayout

NODES = (*LOOP_NODES, "recorder")
NOT_RANDOM = 0x0040000  # ADDR_NO_RANDOMIZE of personality(2)
EQUAL_ADDRESSES = pytest.mark.skipif(
    subprocess.run(["setarch", "-R", "true"], stderr=subprocess.DEVNULL).returncode != 0,
    reason="a container's filter denies equal addresses",
)
SEVERAL_CORES = pytest.mark.skipif(
    len(os.sched_getaffinity(0)) < 2, reason="one core is not to be kept free"
)


def where(tmp_path, layout):
    """Node -> cores, and whether its addresses are those of others, just after its start."""
    processes = NodeProcesses(NODES, Path(os.devnull), tmp_path, layout, lockstep=True)
    try:
        return {
            node: (
                os.sched_getaffinity(pid),
                bool(int(Path(f"/proc/{pid}/personality").read_text(), 16) & NOT_RANDOM),
            )
            for node, pid in processes.pids().items()
        }
    finally:
        processes.stop(0.0)


@EQUAL_ADDRESSES
@SEVERAL_CORES
@pytest.mark.parametrize("composed", [False, True])
def test_nodes_of_the_loop_share_a_core_and_addresses(tmp_path, composed):
    cores = os.sched_getaffinity(0)
    found = where(tmp_path, ProcessLayout(composed=composed))
    for node in LOOP_NODES:
        assert found[node] == ({min(cores)}, True)
    assert found["recorder"] == (cores - {min(cores)}, False)
    assert os.sched_getaffinity(0) == cores


@pytest.mark.parametrize(
    ("layout", "priorities"),
    [
        (ProcessLayout(priority=50), [50, 48, 49]),
        (ProcessLayout(priority=2), [2, 1, 1]),
        (ProcessLayout(priority=50, composed=True), [50, 50, 50]),
    ],
)
def test_who_comes_earlier_in_a_step_gives_way(layout, priorities):
    wishes = [layout.wishes(node) for node in LOOP_NODES]
    assert [wish["thread_priority"] for wish in wishes] == priorities
    assert all(wish["lock_memory"] and wish["keep_awake"] for wish in wishes)


@pytest.mark.parametrize("may", [False, True])
def test_cores_stay_awake_without_being_asked_for_where_that_is_allowed(monkeypatch, may):
    monkeypatch.setattr("seft_ros.test_run.processes.may_keep_awake", lambda: may)
    assert ProcessLayout().wishes("rig") == ({"keep_awake": True} if may else {})
    assert ProcessLayout(pin=False).wishes("rig") == {}


@SEVERAL_CORES
@pytest.mark.parametrize("lockstep", [False, True])
def test_nodes_are_hurried_once_it_is_known_that_a_rig_keeps_a_pace(tmp_path, lockstep):
    layout = ProcessLayout()
    processes = NodeProcesses(NODES, Path(os.devnull), tmp_path, layout, lockstep=True)
    try:
        pids = processes.pids()
        assert {os.sched_getscheduler(pids[n]) for n in LOOP_NODES} == {os.SCHED_BATCH}
        processes.settle(lockstep=lockstep)
        treated = {(os.sched_getscheduler(pids[n]), nice(pids[n])) for n in LOOP_NODES}
        first = FIRST if os.geteuid() == 0 else 0  # whose right it is
        assert treated == {(os.SCHED_BATCH, 0) if lockstep else (os.SCHED_OTHER, first)}
        assert (os.sched_getscheduler(pids["recorder"]), nice(pids["recorder"])) == (0, 0)
    finally:
        processes.stop(0.0)


def nice(pid):
    return os.getpriority(os.PRIO_PROCESS, pid)


def test_what_is_not_pinned_runs_anywhere_and_at_random_addresses(tmp_path):
    found = where(tmp_path, ProcessLayout(pin=False))
    assert found == dict.fromkeys(NODES, (os.sched_getaffinity(0), False))
