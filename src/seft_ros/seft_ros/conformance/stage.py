"""A conformance test over DDS, of a rig that runs, or of the simulated one."""

import os
from collections.abc import Callable
from contextlib import nullcontext

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import ExperimentError, InputError
from seft_msgs_py.node.middleware import prepare_on_this_host

from seft_ros.conformance.conductor import Conductor
from seft_ros.conformance.facts import Facts
from seft_ros.conformance.finding import Finding
from seft_ros.conformance.guard import Guard
from seft_ros.conformance.suite import Suite
from seft_ros.running.observer import Observer
from seft_ros.running.one_node import one_node
from seft_ros.running.processes import NodeProcesses
from seft_ros.running.run import refuse_company
from seft_ros.running.scheduling import prefer_latency

Tell = Callable[[Finding], None]


def conform(
    experiment: Experiment,
    tell: Tell,
    *,
    start_rig: bool,
    amplitude: float | None,
    travel: float,
    force: float,
) -> list[Finding]:
    """Look whether a rig keeps the contract.

    Parameters
    ----------
    experiment : Experiment
        Rate, axes and limits of the tests it is for; with a section of the rig if that is to be
        started.
    tell : callable
        Told each finding as it is made.
    start_rig : bool
        Start the simulated rig; else a rig runs already.
    amplitude : float or None
        Largest command, V.
    travel, force : float
        Largest displacement from where the rig rests, m, and change of force, N.

    Raises
    ------
    InputError
        If other nodes of a test are on the graph, or there is no rig.
    ExperimentError
        If the rig that was started ends, or does not listen to commands.
    """
    prepare_on_this_host()
    observer = Observer()
    try:
        refuse_company(observer, [] if start_rig else ["rig"])
    finally:
        observer.close()
    rig = one_node("rig", experiment, lockstep=False) if start_rig else nullcontext(None)
    facts = Facts.of(experiment)
    with rig as processes:
        prefer_latency(os.getpid())
        guard = Guard(facts, travel, force)
        conductor = Conductor(facts, guard, lambda: _see_alive(processes))
        findings = []
        try:
            for finding in Suite(conductor, facts, amplitude).run():
                findings.append(finding)
                tell(finding)
        finally:
            conductor.close()
    return findings


def _see_alive(processes: NodeProcesses | None) -> None:
    for node, how in processes.ended().items() if processes is not None else ():
        assert processes is not None
        raise (InputError if processes.exit_status(node) == 2 else ExperimentError)(how)
