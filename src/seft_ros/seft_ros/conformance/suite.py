"""All checks over DDS; each relies on those before it."""

import os
import signal
import time
from collections.abc import Iterator
from contextlib import closing, nullcontext, suppress
from dataclasses import replace

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_msgs_py.node.host import boot, started
from seft_msgs_py.wire.outcome import FINISHED, TRIPPED, State
from seft_msgs_py.wire.topics import LOOP_TOPICS, VALVE_COMMAND
from seft_plant_sim.rig_parameters import RIG_TABLE, common_lag
from seft_plant_sim.whole_structure import tested_specimen

from seft_ros.conformance import message_checks, motion_checks
from seft_ros.conformance.driver import (
    ENDED_PHASES,
    LATER,
    SLOW,
    Finding,
    Guard,
    RigAnswer,
    RigExerciser,
    Trial,
    found,
    not_run,
)
from seft_ros.conformance.motion_checks import (
    REACTION_TIMEOUT_S,
    RESTING,
    BadCommands,
    MotionDrive,
    rested,
)
from seft_ros.test_run.observer import alone_on_the_graph
from seft_ros.test_run.processes import one_node, prefer_latency
from seft_ros.test_run.stall_watch import StallWatch

ATTEMPTS = 3
"""Number of tries of a test: this host may have stalled in one."""
MEETING = 1.2  # s
AMPLITUDES = {"V": 0.2, "N": 50.0}
"""Largest command where none is given: 2 % of a valve of 10 V."""
_ABORTED = 0.25  # s of an aborted motion that suffice to check units
HOST_STALLED = ("no new", "silent")
"""Words in the reason of a trip that a stall of this host may have caused."""
TIMING = ("period", "late states")
"""Checks whose failure does not prevent moving the rig."""
LONG = 60.0  # s, announced duration of tests that end before
LEAD, GOING = 0.3, 0.2  # s of rest at the start of a test, and of motion before a watchdog's
BRIEF = 0.5  # s
STILL = 0.5  # s beyond the watchdog's time for which the process of the rig is stopped
_STOP = 0.3  # s from done or tripped to the last state


def check_conformance(
    experiment: Experiment,
    *,
    start_rig: bool,
    amplitude: float | None = None,
    travel: float = 0.005,
    force: float = 2000.0,
) -> Iterator[Finding]:
    """Check whether a rig keeps the contract; gives the findings one by one.

    Parameters
    ----------
    experiment : Experiment
        Rate, axes and limits of its tests; with the section of the rig if that is started here.
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
    alone_on_the_graph([] if start_rig else ["rig"])
    if start_rig:
        experiment = experiment.changed({"rig": {"pace": "realtime"}})
    rig = one_node("rig", experiment) if start_rig else nullcontext(None)
    with rig as processes:
        prefer_latency(os.getpid())
        with closing(
            RigExerciser(experiment, Guard(experiment, travel, force), processes)
        ) as driver:
            yield from Suite(driver, experiment, amplitude).run()


class Suite:
    """Runs the checks of a rig; ``amplitude`` in the unit of its drive, None: `AMPLITUDES`."""

    def __init__(
        self, driver: RigExerciser, experiment: Experiment, amplitude: float | None
    ) -> None:
        self._driver, self._experiment, self._amplitude = driver, experiment, amplitude

    def run(self) -> Iterator[Finding]:
        """Give the findings one by one; checks that need failed ones to pass are not run."""
        for checks in (self._meet, self._move):
            fit = True
            for finding in checks():
                fit = fit and (finding.verdict != "failed" or finding.check in TIMING)
                yield finding
            if not fit:
                yield from (not_run(name, "skipped, fix failures above") for name in LATER)
                return
        yield from self._command_badly()
        yield from self._fall_silent()
        yield self._stand_still()
        yield from self._stop()

    def _meet(self) -> Iterator[Finding]:
        driver, experiment = self._driver, self._experiment
        before = driver.meet(MEETING)
        yield message_checks.check_description(driver.description, experiment)
        yield message_checks.check_signs_of_life(before)
        text = f"{len(before.states)} states while idle"
        yield found("silent before a test", not before.states, text)

    def _move(self) -> Iterator[Finding]:
        """Move the rig; its values are checked only if its messages can be read."""
        driver, experiment = self._driver, self._experiment
        assert driver.description is not None
        self._parameters = driver.description["parameters"]
        name = driver.description.get("drive", VALVE_COMMAND.name)
        self._topic = next(topic for topic in LOOP_TOPICS if topic.name == name)
        amplitude = self._amplitude or AMPLITUDES[self._topic.units[0]]
        period_ns = experiment.timebase.period_ns
        self._drive = drive = MotionDrive(experiment.timebase.dt, amplitude)
        self._long = drive.step_at(LONG)
        driver.connect(self._topic)
        trial, stalls = self._moved()
        self._samples = samples = trial.samples
        yield (form := message_checks.check_form(trial, experiment.axes))
        yield (stamps := message_checks.check_stamps(trial, period_ns))
        yield message_checks.check_end(trial, drive.steps, experiment)
        yield message_checks.check_clock(trial, period_ns)
        if "failed" in (form.verdict, stamps.verdict):
            return
        yield from message_checks.check_timing(samples, drive.dt, stalls)
        yield motion_checks.check_rest(samples, drive)
        try:
            specimen = tested_specimen(experiment)
        except (InputError, KeyError):
            specimen = None
        if len(samples.steps) >= drive.steps:
            yield motion_checks.check_moves(samples, drive)
            yield from motion_checks.check_units(samples, drive, specimen)
            lag = common_lag(experiment["reference_force"])
            yield motion_checks.check_answer_delay(samples, drive, lag)
        elif len(samples.steps) > drive.bell.start + drive.step_at(_ABORTED):
            finding = motion_checks.check_units(samples, drive, specimen)[0]  # may be the cause
            if finding.verdict == "failed":
                yield replace(finding, remedy=f"{finding.remedy}; roughly: the motion was aborted")

    def _moved(self) -> tuple[Trial, list[tuple[float, float]]]:
        """Run the test that moves; again if this host was too slow to answer in time.

        Returns the test, and begin and end of the stalls of this host, s, monotonic.
        """
        driver, drive = self._driver, self._drive
        commands = [*drive.commands.tolist(), 0.0]
        for _ in range(ATTEMPTS):
            watch = StallWatch()
            try:
                watch.begin(sorted(os.sched_getaffinity(0)), drive.dt, 0)
                trial = driver.run(
                    drive.steps, lambda k: driver.command(k, commands[min(k, drive.steps)])
                )
            finally:
                seen = watch.end() or {"intervals_ns": []}
            driver.end(State.TRIPPED if trial.fault else State.DONE)
            tripped = trial.status_of(TRIPPED)
            if tripped is None or not any(word in tripped[1].message for word in HOST_STALLED):
                break
        offset = time.monotonic() - time.time()
        return trial, [(b / 1e9 + offset, e / 1e9 + offset) for b, e in seen["intervals_ns"]]

    def _command_badly(self) -> Iterator[Finding]:
        """Send commands that the rig must refuse, in short tests in which it hardly moves."""
        driver, drive, moved = self._driver, self._drive, self._samples
        bad = BadCommands(driver.commands, drive.amplitude)
        for _ in range(ATTEMPTS):
            trial = driver.run(bad.steps, bad.answers)
            driver.end()
            if trial.status_of(FINISHED) is not None:
                break
        findings = motion_checks.check_refusals(trial, bad, moved, drive)
        yield from findings
        if any(finding.verdict != "passed" for finding in findings):
            why = "too dangerous on a rig that obeys bad commands"
            yield not_run("command beyond the limit", why)
            return
        at, name = drive.step_at(LEAD), "command" if self._topic == VALVE_COMMAND else "force"
        limit = self._parameter(f"limits.{name}")
        trial = driver.run(
            2 * at, lambda step: driver.command(step, 1.2 * (limit or 0.0) if step == at else 0.0)
        )
        driver.end()
        yield motion_checks.check_over_limit(trial.samples, at, limit, moved, drive)

    def _fall_silent(self) -> Iterator[Finding]:
        """Stop sending commands while the rig moves; then stop sending the supervisor's state."""
        driver, drive = self._driver, self._drive
        start, stop = drive.step_at(LEAD), drive.step_at(LEAD) + drive.step_at(GOING)

        def stop_commands(step: int) -> list[bytes]:
            if step >= stop:
                return []
            driver.mark("silent")
            return driver.command(step, drive.amplitude / 4 if step >= start else 0.0)

        def leave_alone(step: int) -> list[bytes]:
            if step < start:
                driver.mark("silent")
            else:
                driver.be_silent()
            return driver.command(step)

        timeout = self._timeout("command")
        longest = LEAD + GOING + timeout + 2 * REACTION_TIMEOUT_S + SLOW / 4
        tripped, watchdog = self._silence(self._topic.name, timeout, stop_commands, longest)
        yield watchdog
        latched = driver.run(self._long, driver.command, BRIEF, ())
        driver.end(State.TRIPPED)
        timeout = self._timeout("supervisor")
        longest = LEAD + 2 * (timeout + REACTION_TIMEOUT_S)
        again, alone = self._silence("supervisor", timeout, leave_alone, longest)
        driver.end(State.TRIPPED)
        yield motion_checks.check_safe_command(tripped, again.samples)
        text = f"{len(latched.states)} states in a test after a trip without a reset"
        rests = not latched.states and latched.status_of(TRIPPED) is not None
        yield found("trip is latched", rests, text)
        yield alone

    def _silence(
        self, silent: str, timeout: float, answer: RigAnswer, longest: float
    ) -> tuple[Trial, Finding]:
        """Wait for a watchdog, then for rest; again if it was late: this host may have been."""
        driver = self._driver
        for attempt in range(ATTEMPTS):
            if attempt:
                driver.end(State.TRIPPED)
            trial = driver.run(self._long, answer, longest, (TRIPPED,))
            by_itself = trial.phase == TRIPPED
            driver.say(State.TRIPPED)
            driver.wait(lambda: bool(rested(driver.trial)), RESTING)
            finding = motion_checks.check_watchdog(trial, timeout, silent, by_itself=by_itself)
            if finding.verdict == "passed" or not by_itself:
                break
        return trial, finding

    def _stand_still(self) -> Finding:
        """Stop the process of the rig in a test at rest, and continue it."""
        driver = self._driver
        assert driver.description is not None
        process = driver.description.get("realtime", {})
        pid, start = process.get("process", (0, -1))
        if process.get("boot") != boot() or not started(pid) == start != -1:
            why = "the driver does not report its process, or is on another host: stop it by hand"
            return not_run("stands still", why)
        trial = driver.run(self._long, driver.command, BRIEF, ())
        with suppress(ProcessLookupError):  # it has ended, which is noticed below
            os.kill(pid, signal.SIGSTOP)
            try:
                driver.listen_for(self._timeout("command") + STILL)
            finally:
                os.kill(pid, signal.SIGCONT)
        driver.mark("goes on")
        driver.wait(lambda: trial.phase == TRIPPED, REACTION_TIMEOUT_S)
        driver.end(State.TRIPPED)
        return motion_checks.check_stood_still(trial)

    def _stop(self) -> Iterator[Finding]:
        """End a test as the supervisor; then start one for which the rig was not ready."""
        driver = self._driver
        for state in (State.DONE, State.TRIPPED):
            trial = driver.run(self._long, driver.command, BRIEF, ())
            driver.mark(state)
            driver.say(state)
            driver.listen_for(BRIEF)
            last = trial.last_state_after(state)
            text = f"the last state came {last:.3f} s after, phase {trial.phase or 'none'}"
            rests = trial.phase in ENDED_PHASES and last <= _STOP
            yield found(f"rests when {state}", rests, text, last_state_s=last)
            driver.end(state)
        trial = driver.run(self._long, driver.command, BRIEF, (), ready=False)
        text = f"{len(trial.states)} states in a test that was not ready before"
        yield found("rests in a test under way", not trial.states, text)
        driver.end()

    def _timeout(self, silent: str) -> float:
        """Time within which the rig must trip without commands or supervisor, s."""
        name = f"watchdog.{silent}_timeout"
        return self._parameter(name) or float(RIG_TABLE.rows[name].default)

    def _parameter(self, name: str) -> float | None:
        """Find a parameter in the rig's description; None where it is no number."""
        value = self._parameters.get(name)
        return float(value) if isinstance(value, int | float) else None
