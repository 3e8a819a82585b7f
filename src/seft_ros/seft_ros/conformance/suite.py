"""All checks, in an order in which each relies on those before it."""

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

from seft_msgs_py.wire.outcome import FINISHED, TRIPPED
from seft_msgs_py.wire.topics import LOOP_TOPICS, RIG_STATE
from seft_msgs_py.wire.trajectory import TrajectoryCodec

from seft_ros.conformance import message_checks, motion_checks, timing_checks
from seft_ros.conformance.conductor import ATTEMPTS, SLOW, Conductor
from seft_ros.conformance.drive import Drive
from seft_ros.conformance.facts import Facts
from seft_ros.conformance.finding import Finding, found, not_run
from seft_ros.conformance.obedience_tests import ObedienceTests
from seft_ros.conformance.trial import Samples, Trial
from seft_ros.experiment.state_machine import State
from seft_ros.recording.stall_watch import StallWatch

MEETING = 1.2  # s
AMPLITUDES = {"V": 0.2, "N": 50.0}
"""Largest command where none is given: 2 % of a valve of 10 V."""
PART = 0.25  # s of a motion that was broken off, in which units can be told
HELD_UP = ("no new", "silent")
"""Words of a trip that this host may have brought about, as it stood still itself."""
TIMING = ("period", "late states")
"""Checks whose failure is no reason not to move the rig."""
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
        obedience = ObedienceTests(self._conductor, facts, self._drive, topic)
        yield from obedience.run(samples)

    def _moved(self) -> Trial:
        """Run the test that moves; again where this host was too slow to answer in time."""
        drive = self._drive
        for _ in range(ATTEMPTS):
            watch = StallWatch()
            try:
                watch.begin(sorted(os.sched_getaffinity(0)), drive.dt, 0)
                trial = self._conductor.run(
                    drive.steps,
                    lambda step: [self._conductor.command(step, drive.command(step))],
                    lambda trial: trial.phase in (FINISHED, TRIPPED),
                    SLOW + 3 * drive.steps * drive.dt,
                )
            finally:
                stalls = _stalls(watch)
            trial.stalls = stalls
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
            mend = (
                "look at the rig first; if it has not moved so, that sensor's unit, sign or factor "
                "is wrong (mm for m?); else take a smaller --amplitude"
            )
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
        """Look at the displacement of a motion that was broken off: its unit may be why."""
        part = self._drive.bell
        if len(samples.steps) <= part.start + self._drive.step_at(PART):
            return
        finding = motion_checks.check_units(samples, self._drive, self._facts)[0]
        if finding.verdict == "failed":
            yield replace(finding, mend=f"{finding.mend}; roughly, for the motion was broken off")


def _stalls(watch: StallWatch) -> list[tuple[float, float]]:
    """Begin and end of what the watch saw, s, monotonic."""
    seen = watch.end() or {"intervals_ns": []}
    offset = time.monotonic() - time.time()
    return [(begin / 1e9 + offset, end / 1e9 + offset) for begin, end in seen["intervals_ns"]]
