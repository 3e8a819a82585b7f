"""All checks, in an order in which each relies on those before it."""

import os
import time
from collections.abc import Callable, Iterator

import numpy as np
from seft_msgs_py.outcome import FINISHED, TRIPPED
from seft_msgs_py.topics import LOOP_TOPICS, RIG_STATE
from seft_msgs_py.trajectory import TrajectoryCodec

from seft_ros.conformance import message_checks, motion_checks, obedience_checks, timing_checks
from seft_ros.conformance.bad_commands import BadCommands
from seft_ros.conformance.conductor import Conductor
from seft_ros.conformance.drive import Drive
from seft_ros.conformance.facts import Facts
from seft_ros.conformance.finding import Finding, found, not_run
from seft_ros.conformance.trial import Samples, Trial
from seft_ros.experiment.state_machine import State
from seft_ros.recording.stall_watch import StallWatch

MEETING = 1.2  # s
AMPLITUDES = {"V": 0.2, "N": 50.0}
"""Largest command where none is given: 2 % of a valve of 10 V."""
LONG = 60.0  # s that a test is said to have, which ends before
LEAD, GOING = 0.3, 0.2  # s of rest at the start of a test, and of motion before a watchdog's
BRIEF = 0.5  # s
PART = 0.25  # s of a motion that was broken off, in which units can be told
ATTEMPTS = 3
HELD_UP = ("no new", "silent")
"""Words of a trip that this host may have brought about, as it stood still itself."""
TIMING = ("period", "late states")
"""Checks whose failure is no reason not to move the rig."""
SLOW = 10.0  # times as long as planned a test may take
LATER = (
    "command stale",
    "command a second time",
    "command of the future",
    "command of another axis",
    "command not a number",
    "command between two steps",
    "command beyond the limit",
    "watchdog: valve_command silent",
    "safe position",
    "trip is latched",
    "watchdog: supervisor silent",
    "rests when done",
    "rests when tripped",
    "rests in a test under way",
)

Progress = Callable[[str, int], None]


class Suite:
    """Runs the checks of a rig.

    Parameters
    ----------
    conductor : Conductor
        On the graph.
    facts : Facts
        The rig.
    amplitude : float or None
        Largest command, in the unit of what drives the rig; None: `AMPLITUDES`.
    """

    def __init__(self, conductor: Conductor, facts: Facts, amplitude: float | None) -> None:
        self._conductor, self._facts, self._given = conductor, facts, amplitude
        experiment = facts.experiment
        self._states = TrajectoryCodec(RIG_STATE, experiment.axes, experiment.timebase)

    def run(self) -> Iterator[Finding]:
        """Give the findings one by one; after what makes a rig unfit to be moved, no others."""
        before = self._conductor.meet(MEETING)
        described = message_checks.check_description(
            self._conductor.description, self._facts.experiment
        )
        first = [described, message_checks.check_signs_of_life(before)]
        first.append(message_checks.check_silence(before))
        yield from first
        if any(finding.verdict == "failed" for finding in first):
            yield from (not_run(name, "what is above is to be mended first") for name in LATER)
            return
        assert self._conductor.description is not None
        self._facts = facts = self._facts.described(self._conductor.description)
        topic = next(topic for topic in LOOP_TOPICS if topic.name == facts.drive)
        self._commands = TrajectoryCodec(topic, facts.experiment.axes, facts.experiment.timebase)
        self._amplitude = self._given or AMPLITUDES[topic.units[0]]
        self._drive = Drive(facts.dt, self._amplitude)
        self._conductor.connect(facts.drive)
        sound = True
        moved = self._moved()
        samples = Samples.of(moved, self._states)
        for finding in self._of_motion(moved, samples):
            sound = sound and (finding.verdict != "failed" or finding.check in TIMING)
            yield finding
        if not sound:
            yield from (not_run(name, "what is above is to be mended first") for name in LATER)
            return
        yield from self._of_obedience(samples)

    def _moved(self) -> Trial:
        """Run the test that moves; again where this host was too slow to answer in time."""
        drive = self._drive
        for _ in range(ATTEMPTS):
            watch = StallWatch()
            watch.begin(sorted(os.sched_getaffinity(0)), drive.dt, 0)
            trial = self._conductor.run(
                drive.steps,
                lambda step: [self._encode(step, drive.command(step))],
                lambda trial: trial.phase in (FINISHED, TRIPPED),
                SLOW + 3 * drive.steps * drive.dt,
            )
            trial.stalls = _stalls(watch)
            self._conductor.end(State.TRIPPED if trial.fault else State.DONE)
            tripped = trial.status_of(TRIPPED)
            if tripped is None or not any(word in tripped[1].message for word in HELD_UP):
                break
        return trial

    def _of_motion(self, trial: Trial, samples: Samples) -> Iterator[Finding]:
        experiment, drive = self._facts.experiment, self._drive
        period_ns = experiment.timebase.period_ns
        form = message_checks.check_form(trial, experiment.axes)
        stamps = message_checks.check_stamps(trial, period_ns)
        yield form
        yield stamps
        if trial.fault:
            mend = "look at the rig first; then a smaller --amplitude, or mend what it measures"
            yield found("stays within limits", False, trial.fault, mend)
        else:
            yield message_checks.check_end(trial, drive.steps, experiment)
        yield message_checks.check_clock(trial, period_ns)
        if "failed" in (form.verdict, stamps.verdict):
            return
        yield from timing_checks.check_timing(samples, drive.dt, trial.stalls)
        yield motion_checks.check_rest(samples, drive)
        if len(samples.steps) < drive.steps:
            yield from self._of_part(samples)
            return
        yield motion_checks.check_moves(samples, drive)
        yield from motion_checks.check_units(samples, drive, self._facts)
        yield motion_checks.check_answer_delay(samples, drive, self._facts)

    def _of_part(self, samples: Samples) -> Iterator[Finding]:
        """Look at the units of a motion that was broken off: they may be why."""
        part = self._drive.bell
        if len(samples.steps) > part.start + self._drive.step_at(PART):
            yield from motion_checks.check_units(samples, self._drive, self._facts)

    def _of_obedience(self, moved: Samples) -> Iterator[Finding]:
        drive, facts = self._drive, self._facts
        experiment = facts.experiment
        bad = BadCommands(
            self._commands.topic, experiment.axes, experiment.timebase, self._amplitude
        )
        for _ in range(ATTEMPTS):
            trial = self._test(bad.steps, bad.answers, SLOW)
            if trial.status_of(FINISHED) is not None:
                break
        samples = Samples.of(trial, self._states)
        findings = obedience_checks.check_refusals(trial, samples, bad, moved, drive)
        yield from findings
        yield self._of_limit(moved, all(f.verdict == "passed" for f in findings))
        yield from self._of_watchdogs()
        for state in (State.DONE, State.TRIPPED):
            self._conductor.run(self._long, self._still, self._after(BRIEF), SLOW)
            self._conductor.say(state)
            self._conductor.listen(BRIEF)
            yield obedience_checks.check_stop(self._conductor.trial, state)
            self._conductor.end(state)
        trial = self._conductor.run(self._long, self._still, self._after(BRIEF), SLOW, ready=False)
        yield obedience_checks.check_not_ready(trial)
        self._conductor.end()

    def _of_limit(self, moved: Samples, obedient: bool) -> Finding:
        name, limit = "command beyond the limit", self._facts.largest_command
        if not obedient:
            return not_run(name, "a rig that acts upon bad commands is not sent so large a one")
        at = self._drive.step_at(LEAD)

        def answer(step: int) -> list[bytes]:
            return [self._encode(step, 1.2 * limit if step == at and limit is not None else 0.0)]

        trial = self._test(2 * at, answer, SLOW)
        samples = Samples.of(trial, self._states)
        return obedience_checks.check_over_limit(samples, at, limit, moved, self._drive)

    def _of_watchdogs(self) -> Iterator[Finding]:
        conductor, facts = self._conductor, self._facts
        start = self._drive.step_at(LEAD)
        stop = start + self._drive.step_at(GOING)

        def answer(step: int) -> list[bytes]:
            if step >= stop:
                return []
            conductor.mark("silent")
            return [self._encode(step, self._amplitude / 4 if step >= start else 0.0)]

        longest = LEAD + GOING + facts.command_timeout + 2 * obedience_checks.PATIENCE
        for attempt in range(ATTEMPTS):
            tripped = conductor.run(self._long, answer, _has_tripped, longest + SLOW / 4)
            by_itself = _has_tripped(tripped)
            conductor.say(State.TRIPPED)
            self._wait_for_rest(tripped)
            watchdog = obedience_checks.check_watchdog(
                tripped, facts.command_timeout, facts.drive, "silent"
            )
            is_late = watchdog.verdict == "failed" and by_itself  # this host may have stood still
            if not is_late or attempt == ATTEMPTS - 1:
                break
            conductor.end(State.TRIPPED)
        yield watchdog
        last = Samples.of(tripped, self._states)
        latched = conductor.run(self._long, self._still, self._after(BRIEF), SLOW)
        conductor.end(State.TRIPPED)
        again = conductor.run(self._long, self._still, self._after(LEAD), SLOW)
        conductor.player.be_silent()
        conductor.mark("alone")
        deadline = time.monotonic() + facts.supervisor_timeout + 2 * obedience_checks.PATIENCE
        while not _has_tripped(again) and time.monotonic() < deadline:
            conductor.listen(0.05)
        conductor.end(State.TRIPPED)
        rested = Samples.of(again, self._states)
        yield obedience_checks.check_safe_position(tripped, last, rested)
        yield obedience_checks.check_latched(latched)
        yield obedience_checks.check_watchdog(
            again, facts.supervisor_timeout, "supervisor", "alone"
        )

    def _wait_for_rest(self, trial: Trial) -> None:
        deadline = time.monotonic() + obedience_checks.SETTLE
        while time.monotonic() < deadline:
            if obedience_checks.rested(trial) is not None:
                return
            self._conductor.listen(0.05)

    def _test(self, steps: int, answer: Callable[[int], list[bytes]], patience: float) -> Trial:
        """Run a test to its end."""
        trial = self._conductor.run(
            steps,
            answer,
            lambda trial: trial.phase in (FINISHED, TRIPPED),
            patience + 3 * steps * self._drive.dt,
        )
        self._conductor.end()
        return trial

    @property
    def _long(self) -> int:
        return self._drive.step_at(LONG)

    def _still(self, step: int) -> list[bytes]:
        return [self._encode(step, 0.0)]

    def _encode(self, step: int, value: float) -> bytes:
        return self._commands.encode(step, np.full(len(self._facts.experiment.axes), value))

    def _after(self, duration: float) -> Callable[[Trial], bool]:
        return lambda trial: time.monotonic() - trial.marks["running"] > duration


def _stalls(watch: StallWatch) -> list[tuple[float, float]]:
    """Begin and end of what the watch saw, s, monotonic."""
    seen = watch.end() or {"intervals_ns": []}
    offset = time.monotonic() - time.time()
    return [(begin / 1e9 + offset, end / 1e9 + offset) for begin, end in seen["intervals_ns"]]


def _has_tripped(trial: Trial) -> bool:
    return trial.phase == TRIPPED
