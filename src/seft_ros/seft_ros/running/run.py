"""A whole test as separate processes: start, wait until all match, run, record, stop."""

import os
import shutil
import tempfile
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from seft_msgs_py.errors import ExperimentError, InputError
from seft_msgs_py.experiment import Experiment

from seft_ros.experiment.peers import CONFLICT
from seft_ros.experiment.state_machine import State
from seft_ros.running.observer import Observer
from seft_ros.running.processes import MODULES, NodeProcesses

READY_TIMEOUT = 60.0  # s
SAVE_TIMEOUT = 20.0  # s
DISCOVERY = 1.0  # s
ANNOUNCEMENT = 3.2  # s; participants announce themselves every 3 s
FASTDDS_PROFILES = Path(__file__).with_name("fastdds.xml")
LOOK = 0.05  # s

Progress = Callable[[str, int], None]
"""Called with what is going on and the steps done."""


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
    *,
    pin: bool = True,
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
    pin : bool
        Keep the loop's nodes on one core and the others off it.
    external : collection of str
        Nodes that someone else starts and ends; they are waited for. The experiment needs no
        section of them.

    Raises
    ------
    InputError
        If the nodes do not become ready.
    ExperimentError
        If the run broke before anything was recorded.
    """
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(FASTDDS_PROFILES))
    experiment["recorder"].update(directory=str(bag.parent.resolve()), name=bag.name)
    wanted = {*experiment["supervisor"]["peers"], "supervisor"} - set(external)
    nodes = [node for node in MODULES if node in wanted]
    with _working_folder(bag) as folder:
        parameters = folder / "parameters.yaml"
        parameters.write_text(experiment.to_yaml(), encoding="utf-8")
        progress("looking for other tests", 0)
        observer = Observer()
        try:
            _refuse_company(observer, external)
            progress("starting the nodes", 0)
            processes = NodeProcesses(
                nodes,
                parameters,
                folder,
                pin=pin,
                lockstep=experiment.sections.get("rig", {}).get("pace") == "lockstep",
            )
            try:
                _wait_until_ready(observer, processes, progress)
                _refuse_twins(observer)
                accepted, answer = observer.call("start")
                if not accepted:
                    raise ExperimentError(f"the supervisor refused to start: {answer}")
                fault = _follow(observer, processes, progress, experiment)
                _wait_until_saved(observer, processes)
            finally:
                processes.stop()
        finally:
            observer.close()
    if not bag.exists():
        raise ExperimentError(fault or "the recorder made no bag")
    return Finished(bag, fault)


def _refuse_company(observer: Observer, external: Collection[str]) -> None:
    """See that no other test is on the graph: two would command each other's rig."""
    observer.spin(DISCOVERY)
    _refuse([node for node in observer.present() if node not in external])


def _refuse_twins(observer: Observer) -> None:
    """See once more that no other test is there.

    A single node that runs already may not be seen before it announces itself the next time.
    """
    observer.spin(max(0.0, observer.since + ANNOUNCEMENT - time.monotonic()))
    _refuse(observer.twins())


def _refuse(nodes: list[str]) -> None:
    if nodes:
        domain = os.environ.get("ROS_DOMAIN_ID", "0")
        raise InputError(
            f"ROS domain {domain} already has a node {', '.join(nodes)}: another test's; end "
            "it, set ROS_DOMAIN_ID to another number, or let a test have it with --external"
        )


def _wait_until_ready(observer: Observer, processes: NodeProcesses, progress: Progress) -> None:
    deadline = time.monotonic() + READY_TIMEOUT
    while observer.state != State.READY:
        observer.spin(LOOK)
        for node, how in processes.ended().items():
            raise InputError(f"{how}" if processes.exit_status(node) else f"node {node} ended")
        detail = observer.values.get("detail", "waiting for supervisor")
        progress(detail, 0)
        if detail.startswith(f"waiting for {CONFLICT}"):  # waiting does not mend it
            raise InputError(f"the nodes must have {detail.removeprefix('waiting for ')}")
        if time.monotonic() > deadline:
            raise InputError(f"not ready after {READY_TIMEOUT:g} s: {detail}")


def _follow(
    observer: Observer, processes: NodeProcesses, progress: Progress, experiment: Experiment
) -> str:
    """Watch a running test to its end; return what broke it, if anything did."""
    period = experiment.timebase.period_ns
    while True:
        observer.spin(LOOK)
        progress("running", observer.time_ns // period)
        if observer.state == State.DONE:
            progress("done", observer.time_ns // period + 1)
            return "" if "stopped" not in observer.values["detail"] else observer.values["detail"]
        if observer.state == State.TRIPPED:
            step = observer.values.get("step")
            return "" if step is not None else observer.values["detail"]
        for how in processes.ended().values():
            return f"{how} (at step {observer.time_ns // period})"


def _wait_until_saved(observer: Observer, processes: NodeProcesses) -> None:
    deadline = time.monotonic() + SAVE_TIMEOUT
    while observer.recorder_phase != "saved" and time.monotonic() < deadline:
        if observer.state not in (State.DONE, State.TRIPPED) or "recorder" in processes.ended():
            return  # the recorder closes its bag when it is told to end
        observer.spin(LOOK)


@contextmanager
def _working_folder(bag: Path) -> Iterator[Path]:
    """Folder for parameters and logs while the test runs; kept in the bag's folder."""
    folder = Path(tempfile.mkdtemp(prefix="seft-"))
    try:
        yield folder
    finally:
        if bag.is_dir():
            shutil.copytree(folder, bag / "logs", dirs_exist_ok=True)
        shutil.rmtree(folder, ignore_errors=True)
