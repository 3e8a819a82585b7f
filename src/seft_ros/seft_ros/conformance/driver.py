"""The test driver plays supervisor and force controller for a rig; what each check found."""

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from rich.text import Text
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import CHANNELS
from seft_msgs_py.errors import ExperimentError, InputError
from seft_msgs_py.printing import escaped
from seft_msgs_py.wire.messages import Status, decode_clock, decode_description
from seft_msgs_py.wire.outcome import FINISHED, TRIPPED, State
from seft_msgs_py.wire.topics import CLOCK_TOPIC, DESCRIPTION, RIG_STATE, LoopTopic
from seft_msgs_py.wire.trajectory import TrajectoryCodec
from seft_plant_sim.limits import Limits

from seft_ros.test_run.observer import SimulatedPeer
from seft_ros.test_run.processes import NodeProcesses

_Verdict = Literal["passed", "failed", "not run"]

CHECK_KINDS = (
    *("stale", "a second time", "of the future", "of another axis", "not a number"),
    "between two steps",
)
"""Kinds of commands that a rig must refuse."""
_REFUSE = "refuse it, as seft_plant_sim.command.Command does: count it as a missing command"
_MOTION = {
    "description": "publish JSON with node and parameters on experiment/description, latched",
    "diagnostics": "send a status named rig with its phase five times a second",
    "silent before a test": "publish rig/state only while experiment/state is running or "
    "ramping_down",
    "form of rig/state": "one point with positions, velocities, accelerations and effort of each "
    "axis",
    "stamps": "stamp sample k with exactly k periods in integer nanoseconds, from 0 at the test's "
    "start; neither a wall clock nor floats (seft_msgs_py's TrajectoryCodec does)",
    "stays within limits": "look at the rig first; if it has not moved like this, that sensor's "
    "unit, sign or factor is wrong (mm for m?); else choose a smaller --amplitude",
    "end of a test": "end after as many states as experiment/state says (steps); report phase "
    "finished with seft_msgs_py's rig_status, and idle again when experiment/state is idle",
    "/clock": "publish the stamp of the last state on /clock, ten times a second",
    "period": "sample at absolute deadlines, start + k periods; repeated sleeps of a period drift",
    "late states": "",
    "at rest": "the valve is not at its centre, or something moves the rig: trim the valve's null",
    "follows the command": "is the pressure on? Then raise --amplitude",
    "velocity of displacement": "",
    "acceleration of velocity": "",
    "force of specimen": "",
    "answer applied": "apply the command that answers sample k from sample k+1 on, without a queue",
}
_OBEDIENCE = {
    **{f"command {kind}": _REFUSE for kind in CHECK_KINDS},
    "command beyond the limit": "refuse it: a command beyond the limit is a fault",
    "watchdog: valve_command silent": "",
    "safe command": "bring the valve to its safe command in every trip, wait until the rig is at "
    "rest, and report 'stop time (s)' and 'stop peak force (N)' in the status of the trip",
    "trip is latched": "keep a trip until experiment/state is idle",
    "watchdog: supervisor silent": "",
    "stands still": "before each command check the age of the last new one, by a clock that does "
    "not stop, as seft_plant_sim.rig_watch.CommandWatch does",
    "rests when done": "end the test at once when experiment/state is done",
    "rests when tripped": "end the test at once when experiment/state is tripped",
    "rests in a test under way": "start only if experiment/state was ready before: a rig that "
    "starts late stays at rest",
}
CHECKS = {**_MOTION, **_OBEDIENCE}
"""Name of each check, and how to fix a failure; empty: it depends on what was measured."""
LATER = tuple(_OBEDIENCE)
"""Checks that are run only on a rig that has passed those before them."""


@dataclass(frozen=True)
class Finding:
    """One check.

    Attributes
    ----------
    check : str
        Its name.
    verdict : str
        ``passed``, ``failed`` or ``not run``.
    result : str
        The result, with the measured number; or why it was not run.
    remedy : str
        What to do about a failure.
    measured : dict of str to float
        The numbers, by name with unit.
    """

    check: str
    verdict: _Verdict
    result: str
    remedy: str = ""
    measured: dict[str, float] = field(default_factory=dict)


def found(check: str, passed: bool, result: str, remedy: str = "", **measured: float) -> Finding:
    """Make the finding of a check that was run; only of a failed one it says how to fix it."""
    remedy = "" if passed else remedy or CHECKS.get(check, "")
    return Finding(check, "passed" if passed else "failed", result, remedy, measured)


def not_run(check: str, why: str) -> Finding:
    """Make the finding of a check that could not be run."""
    return Finding(check, "not run", why)


_MARKS = {
    "passed": ("passed ", "green"),
    "failed": ("FAILED ", "red"),
    "not run": ("not run", "dim"),
}


def finding_line(finding: Finding) -> Text:
    """Describe a finding in one line; below, how to fix it."""
    mark, colour = _MARKS[finding.verdict]
    line = escaped(f"  {finding.check}: {finding.result}")  # a driver's text
    text = Text.assemble((mark, f"bold {colour}"), line)
    if finding.remedy:
        text.append(escaped(f"\n           -> {finding.remedy}"))
    return text


def summarise_findings(findings: Sequence[Finding]) -> dict[str, Any]:
    """Assess a rig by all findings; JSON values.

    Returns
    -------
    dict
        ``conforms``, how many checks ``passed``, ``failed`` and were ``not_run``, and ``checks``:
        of each ``check``, ``verdict``, ``result``, ``remedy``, ``measured``.
    """
    counts = {
        word.replace(" ", "_"): sum(finding.verdict == word for finding in findings)
        for word in _MARKS
    }
    checks = [asdict(finding) | {"remedy": finding.remedy or None} for finding in findings]
    return {"conforms": not counts["failed"] and bool(findings), **counts, "checks": checks}


BASELINE = 20  # samples at rest that the motion is counted from
FOUND = 20.0  # s until the rig is found
_LOOK = 0.02  # s
NOTED = 0.15  # s for the rig to take in a state
SLOW = 10.0  # s more than planned that a test may take
PHASES = 2.0  # s for it to say that it has ended, and that it is idle again
ENDED_PHASES = (FINISHED, TRIPPED)
RigAnswer = Callable[[int], list[bytes]]
"""Gives the messages that answer a step."""


class Samples(NamedTuple):
    """N states that could be read: steps, samples (N, 4, n), what is applied (N, n), times, s.

    The times are those of sending, so that delays of this host are not counted as the rig's.
    """

    steps: npt.NDArray[np.int64]
    values: Floats
    drives: Floats
    times: Floats


@dataclass
class Trial:
    """Messages of the rig in one test, as received, each with its time, monotonic, s.

    ``read`` has step, sample, drive and time of sending of the states that could be read;
    ``marks`` has the times of what was done to the rig; ``fault`` why the test was aborted.
    """

    states: list[tuple[float, bytes]] = field(default_factory=list)
    read: list[tuple[int, Floats, Floats, float]] = field(default_factory=list)
    statuses: list[tuple[float, Status]] = field(default_factory=list)
    clocks: list[tuple[float, int]] = field(default_factory=list)
    marks: dict[str, float] = field(default_factory=dict)
    fault: str = ""

    def status_of(self, phase: str) -> tuple[float, Status] | None:
        """Give the time and the first status with a phase; None if there is none."""
        return next((s for s in self.statuses if s[1].values.get("phase") == phase), None)

    @property
    def phase(self) -> str:
        """Last phase of the rig; empty if there is none."""
        return self.statuses[-1][1].values.get("phase", "") if self.statuses else ""

    def last_state_after(self, mark: str) -> float:
        """Time from a mark to the last state, s; 0 if none came after it."""
        return max([0.0, *(at - self.marks[mark] for at, _ in self.states)])

    @property
    def samples(self) -> Samples:
        """States that could be read."""
        if not self.read:
            return Samples(
                np.empty(0, np.int64), np.empty((0, 4, 1)), np.empty((0, 1)), np.empty(0)
            )
        return Samples(*(np.array(column) for column in zip(*self.read, strict=True)))


class Guard:
    """Watches each sample of a rig whose sensors are not trusted yet.

    A sensor beyond a limit of the experiment ends the test. The far smaller limits of this test
    must be exceeded by two of displacement, integrated velocity and force: a single wrong sensor
    is to be found by the test.

    Parameters
    ----------
    experiment : Experiment
        Limits of its supervisor, and rate.
    travel : float
        Largest displacement from where the rig rested, m.
    force : float
        Largest change of force, N.
    """

    def __init__(self, experiment: Experiment, travel: float, force: float) -> None:
        supervisor, axes = experiment["supervisor"], experiment.axes
        self._dt, self._travel, self._force = experiment.timebase.dt, travel, force
        limits = {name: supervisor[f"limits.{name}"] for name in CHANNELS}
        self._limits = Limits(limits, axes, self._dt)
        self._limits.violation(np.zeros((4, len(axes))))  # the first call takes longest
        self.reset()

    def reset(self) -> None:
        """Begin with a rig at rest."""
        self._limits.reset()
        self._samples: list[Floats] = []
        self._moved: Floats | float = 0.0  # integrated velocity of each axis, m

    def fault(self, sample: Floats) -> str:
        """Take a sample, shape (4, n); say why the test must be aborted; empty if it need not."""
        way = float(np.abs(self._moved).max())
        if broken := self._limits.violation(sample):
            return f"measured {broken}; by its velocity the rig has moved {way:.2g} m"
        if len(self._samples) < BASELINE:
            self._samples.append(np.array(sample))
            return ""
        change = sample - np.mean(self._samples, axis=0)
        self._moved = self._moved + change[1] * self._dt
        way = float(np.abs(self._moved).max())
        moved, _, _, pushed = np.abs(change).max(axis=1).tolist()
        if sum((moved > self._travel, way > self._travel, pushed > self._force)) < 2:
            return ""
        return (
            f"moved {moved:.3g} m, {way:.3g} m by its velocity, force changed {pushed:.4g} N: more "
            f"than {self._travel:g} m and {self._force:g} N"
        )


class RigExerciser(SimulatedPeer):
    """Runs short tests on a rig and records its messages.

    Parameters
    ----------
    experiment : Experiment
        Its rate and axes.
    guard : Guard
        Watches each sample.
    processes : NodeProcesses or None
        The rig's process, if it was started here.
    """

    def __init__(
        self, experiment: Experiment, guard: Guard, processes: NodeProcesses | None
    ) -> None:
        self._guard, self._processes = guard, processes
        self.description: Mapping[str, Any] | None = None
        self.trial = Trial()  # the running test, or the last one
        self._samples = TrajectoryCodec(RIG_STATE, experiment.axes, experiment.timebase)
        self._answer: RigAnswer | None = None
        receives = {RIG_STATE: self._on_state, CLOCK_TOPIC: self._on_clock}
        super().__init__("seft_conform", [], {**receives, DESCRIPTION: self._on_description})

    def meet(self, duration: float) -> Trial:
        """Find the rig and listen to it for some time, in idle.

        Raises
        ------
        InputError
            If no node rig publishes rig/state.
        """

        def is_found() -> bool:
            known = self.description is not None and "rig" in self.status
            return known and self.is_matched("rig", [], [RIG_STATE])

        self.say(State.IDLE)
        if not self.wait(is_found, FOUND):
            raise InputError(
                f"no node rig with rig/state and experiment/state within {FOUND:g} s; start "
                "it on this ROS domain, or use --start-rig for the simulated one"
            )
        self.trial = Trial()
        self.listen_for(duration)
        return self.trial

    def connect(self, topic: LoopTopic) -> None:
        """Publish the commands that drive the rig; wait until it receives them."""
        self.commands = TrajectoryCodec(topic, self._samples.axes, self._samples.timebase)
        self.publish_on(topic)
        if not self.wait(lambda: self.is_matched("rig", [topic], [RIG_STATE]), FOUND):
            raise ExperimentError(f"the rig does not listen to {topic.name} within {FOUND:g} s")

    def command(self, step: int, value: float = 0.0) -> list[bytes]:
        """Answer a step with the same command for each axis."""
        return [self.commands.encode(step, np.full(len(self.commands.axes), value))]

    def run(
        self,
        steps: int,
        answer: RigAnswer,
        patience: float | None = None,
        until: tuple[str, ...] = ENDED_PHASES,
        *,
        ready: bool = True,
    ) -> Trial:
        """Run a test until the rig reports a phase, the time is over, or the guard aborts it.

        Parameters
        ----------
        steps : int
            Of the test, as announced to the rig.
        answer : callable
            Gives the messages that answer a step.
        patience : float, optional
            Longest time of the test, s; default long enough for all steps.
        until : tuple of str
            Phases.
        ready : bool
            Whether the state ready is announced before.
        """
        self.trial = trial = Trial()
        self._guard.reset()
        if ready:
            self.say(State.READY)
            self.listen_for(NOTED)
        self._answer = answer
        self.say(State.RUNNING, steps, pace="realtime")
        if patience is None:
            patience = SLOW + 3 * steps * self._samples.timebase.dt
        self.wait(lambda: trial.phase in until or bool(trial.fault), patience)
        if trial.fault:
            self.say(State.TRIPPED)
        return trial

    def mark(self, name: str) -> None:
        """Record the time under a name."""
        self.trial.marks[name] = time.monotonic()

    def end(self, state: State = State.DONE) -> None:
        """End a test, and bring the rig back to idle."""
        self.say(state)
        self.wait(lambda: self.trial.phase in (*ENDED_PHASES, "idle"), PHASES)
        self._answer = None
        self.say(State.IDLE)
        self.wait(lambda: self.trial.phase == "idle", PHASES)

    def wait(self, condition: Callable[[], bool], patience: float) -> bool:
        """Receive and answer messages until a condition holds; return whether it does."""
        deadline = time.monotonic() + patience
        while not condition():
            if time.monotonic() > deadline:
                return False
            self.listen(_LOOK)
            if self._processes is not None:
                self._processes.raise_if_ended()
        return True

    def close(self) -> None:
        """Leave the rig at rest, and the graph."""
        with contextlib.suppress(ExperimentError):  # an error before has said that it is gone
            self.say(State.IDLE)
        super().close()

    def _on_state(self, raw: bytes, at: float, sent: float) -> None:
        trial = self.trial
        trial.states.append((at, raw))
        step, values = self._samples.decode(raw)  # what can't be read can't be answered
        trial.read.append((step, values[0, :4], values[0, 4], sent))
        if self._answer is None:
            return
        for message in self._answer(step):
            self.send(self.commands.topic, message)
        trial.fault = trial.fault or self._guard.fault(values[0, :4])

    def _on_clock(self, raw: bytes, at: float, sent: float) -> None:
        self.trial.clocks.append((at, decode_clock(raw)))

    def _on_description(self, raw: bytes, at: float, sent: float) -> None:
        node, description = decode_description(raw)
        if node == "rig":
            self.description = description

    def on_status(self, status: Status, at: float) -> None:
        """Record the status of the rig."""
        if status.name == "rig":
            self.trial.statuses.append((at, status))
