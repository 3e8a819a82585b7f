"""Watches a test that runs, to its end, whoever dies, stands still or interrupts on the way."""

import contextlib
import time
from collections.abc import Callable
from types import FrameType
from typing import Self

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import ExperimentError, InputError
from seft_msgs_py.node.ending import as_before, on_ending
from seft_msgs_py.wire.topics import EXPERIMENT_STATE, LoopTopic, topics_of

from seft_ros.experiment.peers import CONFLICT, SILENT
from seft_ros.experiment.state_machine import ENDED, PACE, State
from seft_ros.running.observer import Observer
from seft_ros.running.processes import NodeProcesses

LOOK = 0.05  # s
READY_TIMEOUT, SAVE_TIMEOUT = 60.0, 20.0  # s
SLACK = 1.0  # s beyond the supervisor's own patience
STANDING_STILL = 60.0  # s; a ramp that has not come to its end by then never will

AT_ONCE = 2  # signals that are remembered: for a soft stop, and to abort

Progress = Callable[[str, int], None]
"""Called with what is going on and the steps done."""


class Interruption:
    """Remembers Ctrl-C and its like until it is asked for them; the third one acts at once.

    An exception that a handler raises comes out wherever the program happens to be; within a
    callback that C++ code has called, it is lost, and the test goes on.
    """

    def __init__(self) -> None:
        self._seen = self._given = 0

    def __enter__(self) -> Self:
        self._before = on_ending(self._remember)
        return self

    def __exit__(self, *_: object) -> None:
        as_before(self._before)

    def check(self) -> None:
        """Give way to what was asked for, once for each time.

        Raises
        ------
        KeyboardInterrupt
            If a signal came since the last one was given way to.
        """
        if self._seen > self._given:
            self._given += 1
            raise KeyboardInterrupt

    def _remember(self, number: int, frame: FrameType | None) -> None:
        self._seen += 1
        if self._seen > AT_ONCE:
            raise KeyboardInterrupt


class RunMonitor:
    """Starts a test, watches it, and brings it down where the operator says so.

    Parameters
    ----------
    observer : Observer
        Eyes and ears.
    processes : NodeProcesses
        The nodes that were started here.
    progress : callable
        Told of each stage and of the steps done; may raise KeyboardInterrupt.
    test : Experiment
        Its configuration.
    """

    def __init__(
        self, observer: Observer, processes: NodeProcesses, progress: Progress, test: Experiment
    ) -> None:
        self._observer, self._processes, self._progress = observer, processes, progress
        self._period_ns = test.timebase.period_ns
        self._timeout: float = test["supervisor"]["watchdog.peer_timeout"] + SLACK
        self._topics = [
            topic
            for topic in topics_of(test.rigs)
            if isinstance(topic, LoopTopic) or topic == EXPERIMENT_STATE
        ]
        self._broken = ""

    def start(self) -> None:
        """Start the test when all nodes are ready and nobody else publishes on its topics."""
        observer = self._observer
        deadline = time.monotonic() + READY_TIMEOUT
        self._wait_until_ready(deadline)
        observer.refuse_twins(self._topics)
        self._processes.settle(lockstep=observer.values.get(PACE) == "lockstep")
        while True:
            self._wait_until_ready(deadline)
            accepted, answer = observer.call("start")
            if accepted:
                return
            if observer.state == State.TRIPPED:
                raise ExperimentError(f"the supervisor refused to start: {answer}")
            observer.spin(LOOK)  # a node was away for a moment: wait until all are there again

    def _wait_until_ready(self, deadline: float) -> None:
        while True:
            self._observer.spin(LOOK)
            detail = self._observer.values.get("detail", "waiting for supervisor")
            self._progress(detail, 0)
            self._processes.raise_if_ended()
            for node in self._processes.stopped():
                raise ExperimentError(
                    f"node {node} stands still before the test (a signal stopped it)"
                )
            if self._observer.state == State.READY:
                return
            if self._observer.state == State.TRIPPED:
                raise ExperimentError(f"the test tripped before its start: {detail}")
            if detail.startswith(f"waiting for {CONFLICT}"):  # waiting does not mend it
                raise InputError(f"the nodes must have {detail.removeprefix('waiting for ')}")
            if time.monotonic() > deadline:
                raise InputError(f"not ready after {READY_TIMEOUT:g} s: {detail}")

    def to_the_end(self) -> str:
        """Watch until the test has ended.

        Returns
        -------
        str
            What broke it, with the step; empty if it ended as planned, or by a trip of which
            the bag tells all.
        """
        deadline = float("inf")
        while self._observer.state not in ENDED:
            self._look()
            if self._broken:
                deadline = min(deadline, time.monotonic() + STANDING_STILL)
                if self._is_left_alone() or time.monotonic() > deadline:
                    return self._broken
        deadline = time.monotonic() + self._timeout  # until the supervisor knows who fell silent
        observer = self._observer
        while observer.state == State.TRIPPED and SILENT not in observer.values:
            if time.monotonic() > deadline:
                break
            self._look()
        silent = {*observer.values.get(SILENT, "").split()} - {*self._processes.stopped()}
        while silent and not self._broken and time.monotonic() < deadline:
            self._look()  # who fell silent may be about to end, and then says why
        return self._broken or self._told()

    def bring_down(self) -> None:
        """Stop the test softly and wait for its end; asked again, stop it at once."""
        for service in ("stop", "estop"):
            with contextlib.suppress(KeyboardInterrupt, ExperimentError):
                self._observer.call(service, self._timeout)
                deadline = time.monotonic() + STANDING_STILL
                while self._observer.state not in ENDED and time.monotonic() < deadline:
                    self._look()
                    if self._is_left_alone():
                        return
            if self._observer.state in ENDED:
                return

    def wait_until_saved(self) -> None:
        """Wait for the recorder, unless it is told to end before: then it closes its bag."""
        deadline = time.monotonic() + SAVE_TIMEOUT
        while self._observer.recorder_phase != "saved" and time.monotonic() < deadline:
            gone = {*self._observer.values.get(SILENT, "").split(), *self._processes.ended()}
            if self._observer.state not in ENDED or "recorder" in gone:
                return
            self._observer.spin(LOOK)

    def _look(self) -> None:
        self._observer.spin(LOOK)
        step = self._observer.time_ns // self._period_ns
        for how in self._processes.ended().values():
            self._broken = self._broken or f"{how} (at step {step})"
        silence = self._observer.silence()
        if not self._broken and silence > self._timeout:
            self._broken = f"node supervisor has been silent for {silence:.1f} s (at step {step})"
        self._progress(self._observer.state.replace("_", " "), step)

    def _is_left_alone(self) -> bool:
        """Tell whether nobody is left who could say that the test is over, and the rig rests."""
        return self._observer.silence() > self._timeout and not self._observer.running

    def _told(self) -> str:
        """Say how the test ended where the bag does not, or may not be there to do so."""
        observer = self._observer
        step, values = observer.time_ns // self._period_ns, observer.values
        detail = values.get("detail", "")
        if observer.state == State.DONE:
            stopped, steps = "stopped" in detail, values.get("steps", "")
            self._progress("done", int(steps) if steps and not stopped else step + 1)
            return detail if stopped else ""
        if not values.get(SILENT) and "step" in values:
            return ""
        return f"{detail} (at step {values.get('step', step)})"
