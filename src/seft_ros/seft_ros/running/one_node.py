"""One node of a test in a process of its own, for a command that plays the parts of the others."""

from collections.abc import Iterator
from contextlib import contextmanager

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.node.middleware import prepare_on_this_host

from seft_ros.running.arrangement import Arrangement
from seft_ros.running.observer import Observer
from seft_ros.running.processes import NodeProcesses
from seft_ros.running.run import refuse_company, working_folder
from seft_ros.running.tidying import Tidying


def alone_on_the_graph() -> None:
    """Prepare this process for the graph, and see that no test is on it.

    Raises
    ------
    InputError
        If there is one.
    """
    prepare_on_this_host()
    observer = Observer()
    try:
        refuse_company(observer)
    finally:
        observer.close()


@contextmanager
def one_node(node: str, experiment: Experiment, *, lockstep: bool) -> Iterator[NodeProcesses]:
    """Run a node of an experiment, and end it, whatever comes.

    Parameters
    ----------
    node : str
        Its name.
    experiment : Experiment
        Holds the node's section.
    lockstep : bool
        Whether it need not keep time.

    Yields
    ------
    NodeProcesses
        The node's process.
    """
    with working_folder() as folder:
        parameters = folder / "parameters.yaml"
        parameters.write_text(experiment.to_yaml(), encoding="utf-8")
        tidying = Tidying()
        try:
            arrangement = Arrangement(pin=not lockstep)
            processes = NodeProcesses([node], parameters, folder, arrangement, lockstep=lockstep)
            try:
                tidying.watch(processes.pids().values())
                yield processes
            finally:
                processes.stop()
        finally:
            tidying.finish()
