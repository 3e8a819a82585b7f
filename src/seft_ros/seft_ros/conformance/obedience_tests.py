"""What a rig must refuse, and when it must rest: short tests in which it hardly moves."""

import time
from collections.abc import Callable, Iterator

from seft_msgs_py.wire.outcome import FINISHED, TRIPPED
from seft_msgs_py.wire.topics import RIG_STATE, LoopTopic
from seft_msgs_py.wire.trajectory import TrajectoryCodec

from seft_ros.conformance import obedience_checks
from seft_ros.conformance.bad_commands import BadCommands
from seft_ros.conformance.conductor import ATTEMPTS, SLOW, Conductor
from seft_ros.conformance.drive import Drive
from seft_ros.conformance.facts import Facts
from seft_ros.conformance.finding import Finding, not_run
from seft_ros.conformance.obedience_checks import PATIENCE
from seft_ros.conformance.trial import Samples, Trial
from seft_ros.experiment.state_machine import State

LONG = 60.0  # s that a test is said to have, which ends before
LEAD, GOING = 0.3, 0.2  # s of rest at the start of a test, and of motion before a watchdog's
BRIEF = 0.5  # s


class ObedienceTests:
    """Runs tests with bad commands, with silence, and with words of the supervisor.

    Parameters
    ----------
    conductor : Conductor
        On the graph, connected to the rig.
    facts : Facts
        The rig, as it describes itself.
    drive : Drive
        That it was moved by.
    topic : LoopTopic
        What drives it.
    """

    def __init__(self, conductor: Conductor, facts: Facts, drive: Drive, topic: LoopTopic) -> None:
        self._conductor, self._facts, self._drive = conductor, facts, drive
        self._topic, self._amplitude = topic, drive.amplitude
        experiment = facts.experiment
        self._states = TrajectoryCodec(RIG_STATE, experiment.axes, experiment.timebase)

    def run(self, moved: Samples) -> Iterator[Finding]:
        """Give the findings one by one.

        Parameters
        ----------
        moved : Samples
            Of the test in which the rig was moved.
        """
        drive, facts = self._drive, self._facts
        experiment = facts.experiment
        bad = BadCommands(self._topic, experiment.axes, experiment.timebase, self._amplitude)
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
            return [
                self._conductor.command(
                    step, 1.2 * limit if step == at and limit is not None else 0.0
                )
            ]

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
            return [self._conductor.command(step, self._amplitude / 4 if step >= start else 0.0)]

        longest = LEAD + GOING + facts.command_timeout + 2 * PATIENCE
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
        for attempt in range(ATTEMPTS):
            again = conductor.run(self._long, self._still, self._after(LEAD), SLOW)
            conductor.player.be_silent()
            conductor.mark("alone")
            deadline = time.monotonic() + 2 * (facts.supervisor_timeout + PATIENCE)
            while not _has_tripped(again) and time.monotonic() < deadline:
                conductor.listen(0.05)
            by_itself = _has_tripped(again)
            alone = obedience_checks.check_watchdog(
                again, facts.supervisor_timeout, "supervisor", "alone"
            )
            if alone.verdict == "passed" or not by_itself or attempt == ATTEMPTS - 1:
                break
            conductor.end(State.TRIPPED)
        conductor.end(State.TRIPPED)
        rested = Samples.of(again, self._states)
        yield obedience_checks.check_safe_position(tripped, last, rested)
        yield obedience_checks.check_latched(latched)
        yield alone

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
        return [self._conductor.command(step, 0.0)]

    def _after(self, duration: float) -> Callable[[Trial], bool]:
        return lambda trial: time.monotonic() - trial.marks["running"] > duration


def _has_tripped(trial: Trial) -> bool:
    return trial.phase == TRIPPED
