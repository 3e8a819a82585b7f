"""Where the processes of a test run."""

import os
from contextlib import contextmanager

import pytest
from seft_msgs_py.node.host import FIRST_NICENESS
from seft_msgs_py.wire.topics import LOOP_NODES
from seft_ros.test_run import processes as of_nodes
from seft_ros.test_run.node_starter import NodeStarter
from seft_ros.test_run.processes import NodeProcesses, ProcessLayout

NODES = (*LOOP_NODES, "recorder")
ONE_CORE = len(os.sched_getaffinity(0)) < 2
SEVERAL_CORES = pytest.mark.skipif(ONE_CORE, reason="one core is not to be kept free")


@pytest.fixture(scope="module")
def starter(tmp_path_factory):
    """Give one for all tests, which finds the module of nodes that only wait."""
    folder = tmp_path_factory.mktemp("waiting")
    (folder / "waiting.py").write_text("import signal\n\n\ndef main():\n    signal.pause()\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(folder), prepend=os.pathsep)
        with NodeStarter(()) as found:
            yield found


@pytest.fixture
def run(starter, monkeypatch):
    """Run nodes with a layout, which only wait: none ends before it is looked at."""
    monkeypatch.setattr(of_nodes, "MODULES", dict.fromkeys(NODES, "waiting"))
    monkeypatch.setattr(of_nodes, "COMPOSED", "waiting")

    @contextmanager
    def run_nodes(layout, lockstep=True):
        with NodeProcesses(starter, NODES, [], layout, lockstep=lockstep) as found:
            try:
                yield found
            finally:
                found.stop(0.0)

    return run_nodes


@SEVERAL_CORES
@pytest.mark.parametrize(("composed", "lockstep"), [(False, True), (True, True), (False, False)])
def test_nodes_of_the_loop_have_a_core_of_their_own_and_in_realtime_all(run, composed, lockstep):
    cores = os.sched_getaffinity(0)
    with run(ProcessLayout(composed=composed), lockstep) as processes:
        found = {node: os.sched_getaffinity(pid) for node, pid in processes.pids.items()}
    assert found.pop("recorder") == cores - {min(cores)}
    assert found == dict.fromkeys(LOOP_NODES, {min(cores)} if lockstep else cores)
    assert os.sched_getaffinity(0) == cores


def test_what_is_not_pinned_runs_anywhere(run):
    with run(ProcessLayout(pin=False)) as processes:
        found = {node: os.sched_getaffinity(pid) for node, pid in processes.pids.items()}
    assert found == dict.fromkeys(NODES, os.sched_getaffinity(0))


@pytest.mark.parametrize(
    ("layout", "priorities"),
    [
        (ProcessLayout(priority=50), [50, 48, 49]),
        (ProcessLayout(priority=2), [2, 1, 1]),
        (ProcessLayout(priority=50, composed=True), [50, 50, 50]),
    ],
)
def test_who_comes_earlier_in_a_step_gives_way(layout, priorities):
    realtime_parameters = [layout.realtime_parameters(node) for node in LOOP_NODES]
    assert [wish["thread_priority"] for wish in realtime_parameters] == priorities
    assert all(wish["lock_memory"] and wish["keep_awake"] for wish in realtime_parameters)


@pytest.mark.parametrize("may", [False, True])
def test_cores_stay_awake_without_being_asked_for_where_that_is_allowed(monkeypatch, may):
    monkeypatch.setattr("seft_msgs_py.node.host.may_keep_awake", lambda: may)
    assert ProcessLayout().realtime_parameters("rig") == ({"keep_awake": True} if may else {})
    assert ProcessLayout(pin=False).realtime_parameters("rig") == {}


@SEVERAL_CORES
@pytest.mark.parametrize("lockstep", [False, True])
def test_nodes_are_hurried_once_it_is_known_that_a_rig_keeps_a_pace(run, lockstep):
    with run(ProcessLayout()) as processes:
        pids = processes.pids
        assert {os.sched_getscheduler(pids[n]) for n in LOOP_NODES} == {os.SCHED_BATCH}
        processes.settle(lockstep=lockstep)
        treated = {(os.sched_getscheduler(pids[n]), nice(pids[n])) for n in LOOP_NODES}
        ours = nice(0)
        first = FIRST_NICENESS if os.geteuid() == 0 else ours  # whose right it is
        assert treated == {(os.SCHED_BATCH, ours) if lockstep else (os.SCHED_OTHER, first)}
        assert (os.sched_getscheduler(pids["recorder"]), nice(pids["recorder"])) == (0, ours)


def nice(pid):
    return os.getpriority(os.PRIO_PROCESS, pid)
