"""Runs of the `seft` command and of single nodes, each on a ROS domain of its own."""

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator

import pytest
from commands_at_hand import run_seft
from graph_tools import JHU, PATIENCE
from local_tools import NODES, UNREHEARSED, begin
from ros_domain import reserved_domain
from seft_msgs_py.virtual import LocalGraph
from seft_ros.nodes.loop_node import NODE_KINDS
from seft_ros.test_run.observer import Observer

_HERE = (
    *("simulate", "compare", "preflight", "recover", "replay", "report"),
    *("run", "start", "stop", "reset", "status"),
)
"""Commands that run in this process: to start one takes longer than most of what they do."""
_PATH = os.environ.get("PYTHONPATH")  # a test that changes it wants others' packages to be found


@pytest.fixture
def domain() -> Iterator[int]:
    """A ROS domain that nobody else uses; a module whose tests share one has its own fixture."""
    with reserved_domain() as number:
        yield number


@pytest.fixture
def local_graph():
    """Make the nodes of a test in virtual time, on `JHU`; they end with this test."""
    with contextlib.ExitStack() as made:

        def make(*overrides, config=JHU, kinds=NODE_KINDS, **options):
            graph = LocalGraph(kinds, [config], *overrides, **options)
            return made.enter_context(graph)

        yield make


@pytest.fixture
def compiled(local_graph):
    """Have the steps of an experiment compiled: `seft run` waits for its nodes at most a minute."""

    def prepare(config, *words, nodes=NODES):
        local_graph(*words[1::2], UNREHEARSED, config=config, nodes=nodes).until("ready")

    return prepare


@pytest.fixture
def running(local_graph):
    """Make a test in virtual time that has run for a second."""

    def make(*overrides, **options):
        graph = local_graph(UNREHEARSED, *overrides, **options)
        begin(graph)
        graph.run(1.0)
        assert graph.state == "running"
        return graph

    return make


@pytest.fixture
def seft(domain, tmp_path) -> Callable[..., subprocess.CompletedProcess]:
    """Run `seft` in an empty folder."""

    def run(*words, status=None) -> subprocess.CompletedProcess:
        if "--out" in words and words[0] in ("run", "simulate"):
            words = (*words, "--no-figure")  # which would take longer than many a test
        words = tuple(map(str, words))
        if words[0] in _HERE and os.environ.get("PYTHONPATH") == _PATH:
            done = subprocess.CompletedProcess(words, *run_seft(tmp_path, *words))
        else:
            command = [sys.executable, "-m", "seft_ros.cli.main", *words]
            done = subprocess.run(
                command, cwd=tmp_path, capture_output=True, text=True, timeout=PATIENCE
            )
        if status is not None:
            assert done.returncode == status, done.stderr + done.stdout
        return done

    return run


@pytest.fixture
def seft_json(seft):
    """Run `seft ... --json`; give the object it prints."""

    def run(*words, status=0) -> dict:
        return json.loads(seft(*words, "--json", status=status).stdout)

    return run


@pytest.fixture
def observer(domain) -> Iterator[Observer]:
    """See what goes on on the graph, and call services."""
    watching = Observer()
    yield watching
    watching.close()


@pytest.fixture
def spawn(domain, tmp_path) -> Iterator[Callable[..., subprocess.Popen]]:
    """Start processes in an empty folder; what still runs at the end of the test is killed."""
    started: list[subprocess.Popen] = []

    def launch(*words, **options) -> subprocess.Popen:
        options.setdefault("stderr", subprocess.PIPE)
        process = subprocess.Popen(
            list(map(str, words)), cwd=tmp_path, stdout=subprocess.PIPE, text=True, **options
        )
        started.append(process)
        return process

    yield launch
    for process in started:
        if process.poll() is None:
            process.kill()
        process.communicate()


@pytest.fixture
def start(spawn) -> Callable[..., subprocess.Popen]:
    """Start modules of Python, as `spawn` does."""
    return lambda *words, **options: spawn(sys.executable, "-m", *words, **options)
