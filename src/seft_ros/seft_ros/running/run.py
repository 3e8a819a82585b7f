"""A whole test as separate processes: start, wait until all match, run, record, stop."""

import os
import shutil
import tempfile
import time
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import ExperimentError, InputError
from seft_msgs_py.node.middleware import prepare_on_this_host
from seft_msgs_py.wire.rigs import bare, with_rigs
from seft_msgs_py.wire.topics import NODES, LoopTopic, Topic, topics_of

from seft_ros.experiment.peers import CONFLICT
from seft_ros.experiment.state_machine import PACE, State
from seft_ros.running.arrangement import LOOP_NODES, Arrangement
from seft_ros.running.following import LOOK, Following, Progress
from seft_ros.running.observer import Observer
from seft_ros.running.processes import MODULES, NodeProcesses
from seft_ros.running.tidying import Tidying

READY_TIMEOUT = 60.0  # s
SAVE_TIMEOUT = 20.0  # s
DISCOVERY = 0.5  # s; who is not found by then is at the second look, before anything moves
ANNOUNCEMENT = 3.2  # s; participants announce themselves every 3 s


@dataclass(frozen=True)
class Finished:
    """How a run ended.

    Attributes
    ----------
    bag : Path
        The recorded bag.
    fault : str
        What broke the run, if it was no trip that the bag tells of; else empty.
    """

    bag: Path
    fault: str = ""


def bag_path(experiment: Experiment, out: Path | None) -> Path:
    """Folder of the bag of a test: ``out``, or what the recorder's parameters say.

    Raises
    ------
    InputError
        If it exists already.
    """
    section = experiment["recorder"]
    name = section["name"] or datetime.now().strftime("seft_%Y-%m-%d_%H-%M-%S")
    path = out or Path(section["directory"]) / name
    if path.exists():
        raise InputError(f"{path}: exists already; name another folder with --out")
    return path


def run_experiment(
    experiment: Experiment,
    bag: Path,
    progress: Progress,
    arrangement: Arrangement | None = None,
    external: Collection[str] = (),
) -> Finished:
    """Run a test over DDS and record it.

    Parameters
    ----------
    experiment : Experiment
        Its resolved configuration.
    bag : Path
        Folder that the recorder makes.
    progress : callable
        Told of each stage and of the steps done.
    arrangement : Arrangement, optional
        Where the nodes run; default pinned, each in a process of its own.
    external : collection of str
        Nodes that someone else starts and ends; they are waited for. The experiment needs no
        section of them. Of several rigs those of one or of all: ``east/rig`` or ``rig``.

    Raises
    ------
    InputError
        If the nodes do not become ready.
    ExperimentError
        If the run broke before anything was recorded.
    """
    prepare_on_this_host()
    experiment["recorder"].update(directory=str(bag.parent.resolve()), name=bag.name)
    arrangement = arrangement or Arrangement()
    for node in LOOP_NODES:
        if node in experiment.sections:
            experiment[node].update(arrangement.wishes(node))
    wanted = {*experiment["supervisor"]["peers"], "supervisor"}
    every = with_rigs([node for node in MODULES if node in wanted], experiment.rigs)
    external = [node for node in every if node in external or bare(node) in external]
    nodes = [node for node in every if node not in external]
    with working_folder(bag) as folder:
        parameters = folder / "parameters.yaml"
        parameters.write_text(experiment.to_yaml(), encoding="utf-8")
        progress("looking for other tests", 0)
        tidying = Tidying()
        observer = Observer(with_rigs(NODES, experiment.rigs))
        try:
            refuse_company(observer, external)
            progress("starting the nodes", 0)
            # the pace is the rig's own; that of one which runs elsewhere is told later
            lockstep = "rig" not in map(bare, nodes) or experiment["rig"]["pace"] == "lockstep"
            processes = NodeProcesses(nodes, parameters, folder, arrangement, lockstep=lockstep)
            tidying.watch(processes.pids().values())
            try:
                _start(observer, processes, progress, _of_the_loop(experiment))
                following = Following(observer, processes, progress, experiment)
                try:
                    fault = following.to_the_end()
                except KeyboardInterrupt:
                    following.bring_down()
                    raise
                following.wait_until_saved(SAVE_TIMEOUT)
            finally:
                processes.stop()
        finally:
            observer.close()
            tidying.finish()
    if not bag.exists():
        raise ExperimentError(fault or "the recorder made no bag")
    return Finished(bag, fault)


def refuse_company(observer: Observer, external: Collection[str] = ()) -> None:
    """See that no other test is on the graph: two would command each other's rig.

    Raises
    ------
    InputError
        If there is one.
    """
    observer.spin(DISCOVERY)
    _refuse([node for node in observer.present() if node not in external])


def _refuse_twins(observer: Observer, topics: Iterable[Topic]) -> None:
    """See once more that no other test is there, and nobody else who commands a rig.

    A single node that runs already may not be seen before it announces itself the next time; and
    this process is longer on the graph than those of the test.
    """
    observer.spin(max(0.0, observer.since + ANNOUNCEMENT - time.monotonic()))
    _refuse(observer.twins())
    if conflict := observer.conflict(topics):
        domain = os.environ.get("ROS_DOMAIN_ID", "0")
        raise InputError(
            f"{conflict} in ROS domain {domain}, and only one is this test's: end the other"
        )


def _refuse(nodes: list[str]) -> None:
    if nodes:
        domain = os.environ.get("ROS_DOMAIN_ID", "0")
        raise InputError(
            f"ROS domain {domain} already has a node {', '.join(nodes)}: another test's; end "
            "it, set ROS_DOMAIN_ID to another number, or let a test have it with --external"
        )


def _of_the_loop(experiment: Experiment) -> list[Topic]:
    return [topic for topic in topics_of(experiment.rigs) if isinstance(topic, LoopTopic)]


def _start(
    observer: Observer, processes: NodeProcesses, progress: Progress, topics: Iterable[Topic]
) -> None:
    """Start the test when all nodes are ready and no other test is there."""
    deadline = time.monotonic() + READY_TIMEOUT
    _wait_until_ready(observer, processes, progress, deadline)
    _refuse_twins(observer, topics)
    processes.settle(lockstep=observer.values.get(PACE) == "lockstep")
    while True:
        _wait_until_ready(observer, processes, progress, deadline)
        accepted, answer = observer.call("start")
        if accepted:
            return
        if observer.state == State.TRIPPED:
            raise ExperimentError(f"the supervisor refused to start: {answer}")
        observer.spin(LOOK)  # a node was away for a moment: wait until all are there again


def _wait_until_ready(
    observer: Observer,
    processes: NodeProcesses,
    progress: Progress,
    deadline: float,
) -> None:
    while True:
        observer.spin(LOOK)
        detail = observer.values.get("detail", "waiting for supervisor")
        progress(detail, 0)
        for node, how in processes.ended().items():
            raise (InputError if processes.exit_status(node) == 2 else ExperimentError)(how)
        for node in processes.stopped():
            raise ExperimentError(f"node {node} stands still before the test (a signal stopped it)")
        if observer.state == State.READY:
            return
        if observer.state == State.TRIPPED:
            raise ExperimentError(f"the test tripped before its start: {detail}")
        if detail.startswith(f"waiting for {CONFLICT}"):  # waiting does not mend it
            raise InputError(f"the nodes must have {detail.removeprefix('waiting for ')}")
        if time.monotonic() > deadline:
            raise InputError(f"not ready after {READY_TIMEOUT:g} s: {detail}")


@contextmanager
def working_folder(bag: Path | None = None) -> Iterator[Path]:
    """Folder for parameters and logs while nodes run; kept in the folder of a bag."""
    folder = Path(tempfile.mkdtemp(prefix="seft-"))
    try:
        yield folder
    finally:
        if bag is not None and bag.is_dir():
            shutil.copytree(folder, bag / "logs", dirs_exist_ok=True)
        shutil.rmtree(folder, ignore_errors=True)
