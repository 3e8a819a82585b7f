"""Following a test that runs, to its end, whoever dies or stands still on the way."""

import contextlib
import time
from collections.abc import Callable

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import ExperimentError

from seft_ros.experiment.peers import SILENT
from seft_ros.experiment.state_machine import ENDED, State
from seft_ros.running.observer import Observer
from seft_ros.running.processes import NodeProcesses

LOOK = 0.05  # s
SLACK = 1.0  # s beyond the supervisor's own patience
STANDING_STILL = 60.0  # s; a ramp that has not come to its end by then never will

Progress = Callable[[str, int], None]
"""Called with what is going on and the steps done."""


class Following:
    """Watches a running test, and brings it down where the operator says so.

    Parameters
    ----------
    observer : Observer
        Eyes and ears.
    processes : NodeProcesses
        The nodes that were started here.
    progress : callable
        Told of each stage and of the steps done; may raise KeyboardInterrupt.
    experiment : Experiment
        The test's configuration.
    """

    def __init__(
        self,
        observer: Observer,
        processes: NodeProcesses,
        progress: Progress,
        experiment: Experiment,
    ) -> None:
        self._observer, self._processes, self._progress = observer, processes, progress
        self._period_ns = experiment.timebase.period_ns
        self._timeout: float = experiment["supervisor"]["watchdog.peer_timeout"]
        self._broken = ""

    def to_the_end(self) -> str:
        """Watch until the test has ended.

        Returns
        -------
        str
            What broke it, with the step; empty if it ended as planned, or by a trip of which
            the bag tells all.
        """
        deadline = float("inf")
        while not self._is_over():
            self._look()
            if self._broken:
                deadline = min(deadline, time.monotonic() + STANDING_STILL)
                if self._is_left_alone() or time.monotonic() > deadline:
                    return self._broken
        self._wait_for_the_verdict()
        return self._broken or self._told()

    def bring_down(self) -> None:
        """Stop the test softly and wait for its end; asked again, stop it at once."""
        for service in ("stop", "estop"):
            with contextlib.suppress(KeyboardInterrupt, ExperimentError):
                self._observer.call(service, SLACK + self._timeout)
                deadline = time.monotonic() + STANDING_STILL
                while not self._is_over() and time.monotonic() < deadline:
                    self._look()
                    if self._is_left_alone():
                        return
            if self._is_over():
                return

    def wait_until_saved(self, patience: float) -> None:
        """Wait for the recorder, unless it is told to end before: then it closes its bag."""
        deadline = time.monotonic() + patience
        while self._observer.recorder_phase != "saved" and time.monotonic() < deadline:
            gone = self._observer.values.get(SILENT, "").split()
            if not self._is_over() or "recorder" in gone or "recorder" in self._processes.ended():
                return
            self._observer.spin(LOOK)

    def _look(self) -> None:
        self._observer.spin(LOOK)
        step = self._observer.time_ns // self._period_ns
        for how in self._processes.ended().values():
            self._broken = self._broken or f"{how} (at step {step})"
        silence = self._observer.silence()
        if not self._broken and silence > self._timeout + SLACK:
            self._broken = f"node supervisor has been silent for {silence:.1f} s (at step {step})"
        self._progress(self._observer.state.replace("_", " "), step)

    def _is_over(self) -> bool:
        return self._observer.state in ENDED

    def _is_left_alone(self) -> bool:
        """Tell whether nobody is left who could say that the test is over, and the rig rests."""
        alone = self._observer.silence() > self._timeout + SLACK
        return alone and not self._observer.is_moving

    def _wait_for_the_verdict(self) -> None:
        """Wait until the supervisor knows who fell silent before a trip."""
        deadline = time.monotonic() + self._timeout + SLACK
        while (
            self._observer.state == State.TRIPPED
            and SILENT not in self._observer.values
            and time.monotonic() < deadline
        ):
            self._look()

    def _told(self) -> str:
        """Say how the test ended where the bag does not, or may not be there to do so."""
        step = self._observer.time_ns // self._period_ns
        detail = self._observer.values.get("detail", "")
        if self._observer.state == State.DONE:
            stopped = "stopped" in detail
            steps = self._observer.values.get("steps", "")
            self._progress("done", int(steps) if steps and not stopped else step + 1)
            return detail if stopped else ""
        if not self._observer.values.get(SILENT) and "step" in self._observer.values:
            return ""
        return f"{detail} (at step {self._observer.values.get('step', step)})"
