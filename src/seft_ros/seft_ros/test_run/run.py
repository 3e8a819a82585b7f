"""A whole test as separate processes: start, wait until all are ready, run, record, stop."""

import contextlib
import time
from collections.abc import Callable, Collection
from contextlib import closing
from pathlib import Path
from typing import Self

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import ExperimentError, InputError
from seft_msgs_py.node.process import as_before, on_ending, prepare_on_this_host
from seft_msgs_py.wire import topics
from seft_msgs_py.wire.outcome import BY_OPERATOR, State
from seft_msgs_py.wire.topics import bare, with_rigs

from seft_ros.bags.bag_writer import bag_place, why_not_writable
from seft_ros.test_run.node_starter import NodeStarter
from seft_ros.test_run.observer import Observer
from seft_ros.test_run.parameter_tables import RECORDER_TABLE
from seft_ros.test_run.peers import CONFLICT, RUNS, UNFIT
from seft_ros.test_run.processes import MODULES, NodeProcesses, ProcessLayout

_POLL_PERIOD = 0.05  # s
READY_TIMEOUT, SAVE_TIMEOUT = 60.0, 20.0  # s
SLACK = 1.0  # s beyond the supervisor's own patience
STANDING_STILL = 60.0  # s; a ramp that has not ended by then never will

SIGNALS_TO_ABORT = 2  # signals that are remembered: for a soft stop, and to abort

_Progress = Callable[[str, int], None]
"""Called with the present stage and the steps done; may raise KeyboardInterrupt."""


class Interruption:
    """Remembers Ctrl-C and similar signals until they are asked for; the third acts at once.

    An exception that a handler raises is raised wherever the program happens to be; within a
    callback from C++ code it is lost, and the test would go on.
    """

    def __init__(self) -> None:
        self._seen = self._given = 0

    def __enter__(self) -> Self:
        self._before = on_ending(self._remember)
        return self

    def __exit__(self, *_: object) -> None:
        as_before(self._before)

    def check(self) -> None:
        """Raise KeyboardInterrupt once for each signal that has come."""
        if self._seen > self._given:
            self._given += 1
            raise KeyboardInterrupt

    def _remember(self, *_: object) -> None:
        self._seen += 1
        if self._seen > SIGNALS_TO_ABORT:
            raise KeyboardInterrupt


class RunMonitor:
    """Starts a test, watches it, and brings it down when the operator asks for that.

    Parameters
    ----------
    observer : Observer
        Receives the state of the test.
    processes : NodeProcesses
        The nodes that were started here.
    progress : callable
        See `_Progress`.
    test : Experiment
        Its configuration.
    """

    def __init__(
        self, observer: Observer, processes: NodeProcesses, progress: _Progress, test: Experiment
    ) -> None:
        self._observer, self._processes, self._progress = observer, processes, progress
        self._timebase = test.timebase
        self._timeout: float = test["supervisor"]["watchdog.peer_timeout"] + SLACK
        self._topics = [
            topic
            for topic in topics.topics_of(test.rigs)
            if isinstance(topic, topics.LoopTopic) or topic == topics.EXPERIMENT_STATE
        ]
        self._broken, self._settled = "", False

    def start(self) -> None:
        """Start the test when all nodes are ready and nobody else publishes on its topics."""
        observer = self._observer
        deadline = time.monotonic() + READY_TIMEOUT
        self._wait_until_ready(deadline)
        observer.refuse_twins(self._topics)
        self._settle()
        while True:
            self._wait_until_ready(deadline)
            observer.ended = None  # of a test before this one
            accepted, answer = observer.call("start")
            if accepted:
                return
            if observer.state == State.TRIPPED:
                raise ExperimentError(f"the supervisor refused to start: {answer}")
            observer.spin(_POLL_PERIOD)  # a node was away for a moment: wait for it

    def _settle(self) -> None:
        self._processes.settle(lockstep=self._observer.reported.pace == "lockstep")
        self._settled = True

    def _wait_until_ready(self, deadline: float) -> None:
        observer = self._observer
        while True:
            observer.spin(_POLL_PERIOD)
            detail = observer.reported.detail
            self._progress(detail, 0)
            self._processes.raise_if_ended()
            for node in self._processes.stopped():
                still = "stands still before the test (a signal stopped it)"
                raise ExperimentError(f"node {node} {still}")
            if observer.state == State.READY:
                return
            if observer.state == State.TRIPPED:
                raise ExperimentError(f"the test tripped before its start: {detail}")
            if detail.startswith(f"waiting for {CONFLICT}"):  # waiting does not help
                raise InputError(f"the nodes must have {detail.removeprefix('waiting for ')}")
            if detail.startswith(f"waiting for {UNFIT}"):
                raise ExperimentError(detail.removeprefix(f"waiting for {UNFIT}"))
            if detail == f"waiting for {RUNS}" and not self._settled:
                self._settle()
            if time.monotonic() > deadline:
                raise InputError(f"not ready after {READY_TIMEOUT:g} s: {detail}")

    def to_the_end(self) -> str:
        """Watch until the test has ended.

        Returns
        -------
        str
            What broke it, with the step; empty if it ended as planned or by a stop, or by a trip
            that the bag describes.
        """
        observer, deadline = self._observer, float("inf")
        while observer.ended is None:
            self._poll()
            if self._broken:
                deadline = min(deadline, time.monotonic() + STANDING_STILL)
                if self._is_left_alone() or time.monotonic() > deadline:
                    return self._broken
        deadline = time.monotonic() + self._timeout  # the supervisor finds who fell silent
        while observer.state == State.TRIPPED and observer.ended.silent is None:
            if time.monotonic() > deadline:
                break
            self._poll()
        silent = {*(observer.ended.silent or ())} - {*self._processes.stopped()}
        while silent and not self._broken and time.monotonic() < deadline:
            self._poll()  # a silent node may be ending, and its log then has the cause
        return self._broken or self._ending()

    def bring_down(self) -> bool:
        """Stop the test softly and wait for its end; asked again, stop it at once.

        Return whether it is done: the operator's stop is no fault.
        """
        for service in ("stop", "estop"):
            with contextlib.suppress(KeyboardInterrupt, ExperimentError):
                self._observer.call(service, self._timeout)
                deadline = time.monotonic() + STANDING_STILL
                while self._observer.ended is None and time.monotonic() < deadline:
                    self._poll()
                    if self._is_left_alone():
                        return False
            if self._observer.ended:
                break
        return self._observer.ended is not None and self._observer.ended.state == State.DONE

    def wait_until_saved(self) -> None:
        """Wait for rigs and recorder; one that is stopped before that closes its bag."""
        deadline = time.monotonic() + SAVE_TIMEOUT
        while time.monotonic() < deadline:
            ended = self._observer.ended
            gone = {*((ended and ended.silent) or ()), *self._processes.ended()}
            if ended is None or "recorder" in gone:
                return
            if self._observer.recorder_phase == "saved" and not self._observer.running - gone:
                return
            self._observer.spin(_POLL_PERIOD)

    def _poll(self) -> None:
        self._observer.spin(_POLL_PERIOD)
        step, _ = self._timebase.nearest(self._observer.time_ns)
        for how in self._processes.ended().values():
            self._broken = self._broken or f"{how} (at step {step})"
        silence = self._observer.silence()
        if not self._broken and silence > self._timeout:
            self._broken = f"node supervisor has been silent for {silence:.1f} s (at step {step})"
        self._progress(self._observer.state.replace("_", " "), step)

    def _is_left_alone(self) -> bool:
        """Tell whether no node is left that could report the end, and the rig rests."""
        return self._observer.silence() > self._timeout and not self._observer.running

    def _ending(self) -> str:
        """Say how the test ended if the bag may lack it."""
        observer = self._observer
        step, _ = self._timebase.nearest(observer.time_ns)
        test = observer.ended or observer.reported
        if test.state == State.DONE:
            stopped = test.detail == BY_OPERATOR
            self._progress("done", test.steps if test.steps and not stopped else step + 1)
            return ""
        if not test.silent and test.step is not None:
            return ""
        return f"{test.detail} (at step {step if test.step is None else test.step})"


def bag_path(experiment: Experiment, out: Path | None) -> Path:
    """Folder of the bag of a test: ``out``, or as in the recorder's parameters.

    Raises
    ------
    InputError
        If no bag can be made there.
    """
    path = out or bag_place(experiment["recorder"])
    RECORDER_TABLE.check({"name": path.name}, "recorder")
    if why := why_not_writable(path):
        raise InputError(f"{why}; name another folder with --out")
    return path


def run_experiment(
    experiment: Experiment,
    bag: Path,
    progress: _Progress,
    layout: ProcessLayout | None = None,
    external: Collection[str] = (),
) -> tuple[str, Path]:
    """Run a test over DDS and record it.

    Parameters
    ----------
    experiment : Experiment
        Its resolved configuration.
    bag : Path
        Folder that the recorder makes.
    progress : callable
        See `_Progress`.
    layout : ProcessLayout, optional
        Where the nodes run; default pinned, each in a process of its own.
    external : collection of str
        Nodes that someone else starts and ends; the experiment needs no section of them. Of
        several rigs those of one or of all: ``east/rig`` or ``rig``.

    Returns
    -------
    fault : str
        Empty if there was none, or if the bag has it.
    bag : Path
        The folder of its bag: not the planned one if the recorder lost that.

    Raises
    ------
    InputError
        If the nodes do not become ready.
    ExperimentError
        If the run broke before anything was recorded.
    """
    prepare_on_this_host()
    layout = layout or ProcessLayout()
    ours = [node for node in topics.LOOP_NODES if node in experiment.sections]
    realtime_parameters = {node: layout.realtime_parameters(node) for node in ours}
    recorder = {"directory": str(bag.parent.resolve()), "name": bag.name}
    experiment = experiment.changed(realtime_parameters | {"recorder": recorder})
    wanted = {*experiment["supervisor"]["peers"], "supervisor"}
    every = with_rigs([node for node in MODULES if node in wanted], experiment.rigs)
    external = [node for node in every if node in external or bare(node) in external]
    nodes = [node for node in every if node not in external]
    # the pace is the rig's own; an external rig tells it later
    lockstep = "rig" not in map(bare, nodes) or experiment["rig"]["pace"] == "lockstep"
    progress("looking for other tests", 0)
    observed = with_rigs(topics.NODES, experiment.rigs)
    with NodeStarter() as starter, closing(Observer(observed)) as observer:
        observer.refuse_other_tests(external)
        progress("starting the nodes", 0)
        words = experiment.arguments()
        with NodeProcesses(starter, nodes, words, layout, lockstep=lockstep, bag=bag) as processes:
            monitor = RunMonitor(observer, processes, progress, experiment)
            monitor.start()
            try:
                fault = monitor.to_the_end()
            except KeyboardInterrupt:
                fault, done = "", monitor.bring_down()
                monitor.wait_until_saved()  # a rig that is ended first gives that as the cause
                if not done:
                    raise
            else:
                monitor.wait_until_saved()
            for rig, after in observer.not_at_rest.items():
                text = f"the {rig} is NOT at rest {after} after its stop began"
                fault = f"{text}; {fault}" if fault else text
            saved = observer.recorder_bag
            if saved and Path(saved).resolve() != bag.resolve():  # its own folder was lost
                bag = processes.bag = Path(saved)
    if not bag.exists():
        raise ExperimentError(fault or "the recorder made no bag")
    return fault, bag
