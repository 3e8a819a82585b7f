"""A whole test as separate processes: start, wait until all match, run, record, stop."""

from collections.abc import Collection
from contextlib import closing
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import ExperimentError, InputError
from seft_msgs_py.node.middleware import prepare_on_this_host
from seft_msgs_py.wire.rigs import bare, with_rigs
from seft_msgs_py.wire.topics import NODES

from seft_ros.experiment.watching import RECORDER
from seft_ros.recording.room import obstacle
from seft_ros.running.observer import Observer
from seft_ros.running.process_layout import LOOP_NODES, ProcessLayout
from seft_ros.running.processes import MODULES, node_processes
from seft_ros.running.run_monitor import Progress, RunMonitor


def bag_path(experiment: Experiment, out: Path | None) -> Path:
    """Folder of the bag of a test: ``out``, or what the recorder's parameters say.

    Raises
    ------
    InputError
        If no bag can be made there.
    """
    section = experiment["recorder"]
    name = section["name"] or datetime.now().strftime("seft_%Y-%m-%d_%H-%M-%S")
    path = out or Path(section["directory"]) / name
    RECORDER.check({"name": path.name}, "recorder")
    if why := obstacle(path):
        raise InputError(f"{why}; name another folder with --out")
    return path


class Ending(NamedTuple):
    """How a run ended.

    Attributes
    ----------
    fault : str
        What broke it, if it was no trip that the bag tells of; else empty.
    bag : Path
        Folder of its bag: another than it was to be, where that was lost.
    """

    fault: str
    bag: Path


def run_experiment(
    experiment: Experiment,
    bag: Path,
    progress: Progress,
    layout: ProcessLayout | None = None,
    external: Collection[str] = (),
) -> "Ending":
    """Run a test over DDS and record it.

    Parameters
    ----------
    experiment : Experiment
        Its resolved configuration.
    bag : Path
        Folder that the recorder makes.
    progress : callable
        Told of each stage and of the steps done.
    layout : ProcessLayout, optional
        Where the nodes run; default pinned, each in a process of its own.
    external : collection of str
        Nodes that someone else starts and ends; they are waited for. The experiment needs no
        section of them. Of several rigs those of one or of all: ``east/rig`` or ``rig``.

    Returns
    -------
    Ending
        What broke it, and where its bag is.

    Raises
    ------
    InputError
        If the nodes do not become ready.
    ExperimentError
        If the run broke before anything was recorded.
    """
    prepare_on_this_host()
    experiment["recorder"].update(directory=str(bag.parent.resolve()), name=bag.name)
    layout = layout or ProcessLayout()
    for node in LOOP_NODES:
        if node in experiment.sections:
            experiment[node].update(layout.wishes(node))
    wanted = {*experiment["supervisor"]["peers"], "supervisor"}
    every = with_rigs([node for node in MODULES if node in wanted], experiment.rigs)
    external = [node for node in every if node in external or bare(node) in external]
    nodes = [node for node in every if node not in external]
    # the pace is the rig's own; that of one which runs elsewhere is told later
    lockstep = "rig" not in map(bare, nodes) or experiment["rig"]["pace"] == "lockstep"
    progress("looking for other tests", 0)
    with closing(Observer(with_rigs(NODES, experiment.rigs))) as observer:
        observer.refuse_other_tests(external)
        progress("starting the nodes", 0)
        with node_processes(nodes, experiment, layout, lockstep=lockstep, bag=bag) as processes:
            monitor = RunMonitor(observer, processes, progress, experiment)
            monitor.start()
            try:
                fault = monitor.to_the_end()
            except KeyboardInterrupt:
                monitor.bring_down()
                raise
            monitor.wait_until_saved()
            saved = observer.recorder_bag
            if saved and Path(saved).resolve() != bag.resolve():  # its own place was lost
                bag = processes.bag = Path(saved)
    if not bag.exists():
        raise ExperimentError(fault or "the recorder made no bag")
    return Ending(fault, bag)
