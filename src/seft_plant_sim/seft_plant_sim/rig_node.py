"""Node ``rig``: the simulated rig behind the topics that a lab's hardware driver has.

It publishes rig/state and obeys valve_command (idealised actuators: reference_force). It is
the sampling clock of the test; the supervisor's experiment/state starts and stops it.
"""

import sys
import time
from collections.abc import Callable
from dataclasses import replace

from seft_msgs_py.errors import InputError, WireError
from seft_msgs_py.node.awake_clock import AwakeClock
from seft_msgs_py.node.node_main import NodeBody, NodeKind
from seft_msgs_py.node.node_shell import WARM_UP_STEPS, NodeShell
from seft_msgs_py.wire.messages import Status, decode_status, encode_clock, restamp
from seft_msgs_py.wire.outcome import (
    FINISHED,
    LISTED_STEPS,
    MOVING,
    STOPPED,
    TRIPPED,
    Trip,
    rig_status,
)
from seft_msgs_py.wire.rigs import until_start
from seft_msgs_py.wire.topics import (
    CLOCK_TOPIC,
    DIAGNOSTICS,
    EXPERIMENT_STATE,
    REFERENCE_FORCE,
    RIG_STATE,
    VALVE_COMMAND,
    LoopTopic,
)
from seft_msgs_py.wire.trajectory import Floats, TrajectoryCodec

from seft_plant_sim.command import Command
from seft_plant_sim.rig import Rig, Stopped
from seft_plant_sim.rig_diagnostics import RoundTrip, with_health
from seft_plant_sim.rig_parameters import TABLE
from seft_plant_sim.rig_timing import CommandWatch, RecorderLag, SampleClock, elapsed

CLOCK_PERIOD = 0.1  # s of the test's time
BREATH = 0.005  # s from the first answer in realtime to the time of step 0
LATEST = 256  # steps: an answer that is older has no round trip
FALL_BACK = 0.25  # of a period, by which a rig that is ahead of others delays each next sample
TELL_PERIOD = 1.0  # s, of the diagnostics of a running test


class RigNode(NodeBody):
    """Steps a `Rig` at its pace and moves its samples between topics.

    Parameters
    ----------
    shell : NodeShell
        Node and parameters.
    """

    def __init__(self, shell: NodeShell) -> None:
        super().__init__(shell)
        experiment = shell.experiment
        self._timebase = experiment.timebase
        self._section = experiment["rig"]
        self._rig = Rig.from_parameters(self._section, experiment.axes, self._timebase, shell.rig)
        self._state_codec = TrajectoryCodec(RIG_STATE.of(shell.rig), shell.rig.axes, self._timebase)
        self._publish_state = shell.publisher(RIG_STATE.of(shell.rig))
        # of several rigs, one is the test's clock, and all keep to one start
        self._publish_time: Callable[[bytes], None] | None = None
        if shell.rig.axes[0] == experiment.axes[0]:
            self._publish_time = shell.publisher(CLOCK_TOPIC)
        self._time_message = bytearray(encode_clock(0))
        self._is_alone = len(experiment.rigs) == 1
        self._round_trip = RoundTrip()
        valve = VALVE_COMMAND.of(shell.rig)
        self._valve = self._drive = self._command(valve, shell.rig.axes, "limits.command")
        if self._rig.drive == REFERENCE_FORCE.name:
            delay = max(self._section["loop_delay"], 0)
            axes = experiment.axes
            self._drive = self._command(REFERENCE_FORCE, axes, "limits.force", delay)
        self.facts = {"drive": self._drive.codec.topic.name}
        shell.subscribe(EXPERIMENT_STATE, self._on_experiment_state, depth=16)
        self._recorder_lag = RecorderLag(self._section["lockstep_timeout"])
        if self._section["pace"] == "lockstep":
            shell.subscribe(DIAGNOSTICS, self._recorder_lag.hear)
        self._clock: SampleClock | None = None  # of a test in realtime
        self._watch = CommandWatch(
            self._drive.codec.topic, self._timebase.dt, self._section["watchdog.command_timeout"]
        )
        self._fault = ""  # of the program
        self._armed = False
        self._latched = False  # tripped: no new test before the supervisor has said idle
        self._wanted: Status | None = None
        self._told = ""
        self._awake = AwakeClock()
        self._heard_at = self._awake.time()
        self._clock_steps = max(1, round(CLOCK_PERIOD * self._timebase.rate))
        self._told_at = self._answered_at = 0.0
        self._published_at = [0.0] * LATEST  # the last states, by step
        self._refused_before = 0  # messages, until the newest command came
        self._warm_up()

    def run(self) -> None:
        """Run a test each time the supervisor says so, until told to stop."""
        self._rest()
        while not self._shell.stopping:
            self._shell.spin_once()
            if self._wanted is not None and self._is_moving():
                self._run_test(self._wanted.number("steps") or 0)
                if self._is_moving():
                    self._wanted = None  # a test runs once
            elif self._ended and self._wanted is not None and self._wanted.message == "idle":
                self._rest()  # how the last test ended has been told

    def fault(self, reason: str) -> None:
        """End the test that runs, or the next one, as long as the operator has not reset it."""
        self._fault = reason

    def _command(
        self, topic: LoopTopic, axes: tuple[str, ...], limit: str, loop_delay: int = 0
    ) -> Command:
        codec = TrajectoryCodec(topic, axes, self._timebase)
        rig = None if axes == self._shell.rig.axes else self._shell.rig
        command = Command(codec, self._section[limit], loop_delay, rig)

        def receive(raw: bytes, _: int) -> None:
            command.take(raw)
            if command is self._drive:
                self._answered_at = time.monotonic()
                self._refused_before = self._shell.refused
                if command.current - command.answered < LATEST:
                    published_at = self._published_at[command.answered % LATEST]
                    self._round_trip.add(self._answered_at - published_at)

        self._shell.subscribe(topic, receive, reliable=False)
        return command

    def _rest(self) -> None:
        self._ended = False
        self.report("idle")

    def _warm_up(self) -> None:
        state = self._rig.reset()
        for step in range(WARM_UP_STEPS):
            self._state_codec.decode(self._state_codec.encode(step, state))
            state = self._rig.step(self._drive.value)

    def _run_test(self, steps: int) -> None:
        self._valve.reset()
        self._drive.reset()
        self._missed: list[int] = []
        self._held: list[int] = []  # step of the command applied at each of them
        self._missed_count = 0
        self._clock = None
        self._recorder_lag.reset()
        self._round_trip.reset()
        self._answered_at = 0.0
        self._waited_in_vain = False
        self._refused_before = self._shell.refused
        self._started = time.monotonic()
        state = self._rig.reset()
        self._tell("running")
        reason = self._shell.several_senders() or self._start_together()
        if reason:
            self._publish(0, state)
        else:
            reason = self._fault or self._run_steps_safely(steps, state)
        self._publish_clock(self._rig.step_index)
        self._ended = True
        if reason is None:
            self._tell(FINISHED)
        else:
            self._latched = True
            step = self._rig.step_index
            trip = Trip(reason, step, self._timebase.stamp_ns(step) / 1e9)
            self._tell(TRIPPED, trip)  # before the rig comes to rest: others can stop at once
            self._tell(TRIPPED, trip, self._rig.stop())

    def _run_steps_safely(self, steps: int, state: Floats) -> str | None:
        """Take the samples of a test; a fault of the program ends it as a limit does."""
        try:
            return self._run_steps(steps, state)
        except Exception as error:
            return self._shell.fault("a step", error)

    def _run_steps(self, steps: int, state: Floats) -> str | None:
        """Take the samples of a test at its pace; say why it ended early, if it did."""
        rig, wait = self._rig, self._lockstep
        if self._section["pace"] == "realtime":
            self._start_clock()
            wait = self._realtime
        while self._publish(step := rig.step_index, state):
            why = wait(step, step + 1 == steps)
            if why is not None or rig.violation is not None:
                return rig.violation or why
            if step + 1 == steps:
                return None
            if self._clock is None:
                self._tell_if_due()
            state = rig.step(self._drive.value)
        return rig.violation

    def _start_together(self) -> str | None:
        """Wait for the moment at which all rigs start; say why they can't, if they can't.

        Each samples by its own clock from then on, so these must agree.
        """
        if self._is_alone or self._section["pace"] == "lockstep" or self._wanted is None:
            return None
        try:
            ahead = until_start(self._wanted.values)
        except InputError as error:
            return str(error)
        self._start = time.monotonic() + ahead
        while (left := self._start - time.monotonic()) > 0:
            self._shell.spin_once(left)
            if (why := self._unwanted()) is not None:
                return why
        return None

    def _tell(self, phase: str, trip: Trip | None = None, stopped: Stopped | None = None) -> None:
        self._shell.report(self._status(phase, trip, stopped))

    def _status(
        self, phase: str, trip: Trip | None = None, stopped: Stopped | None = None
    ) -> Status:
        self._told_at = time.monotonic()
        status = rig_status(
            phase,
            self._rig.step_index + 1,
            self._missed_count,
            self._missed,
            self._told_at - self._started,
            trip,
            overruns=self._clock.overruns if self._clock else 0,
            saturation=self._rig.saturation,
            round_trips=self._round_trip.numbers(),
            held_steps=self._held,
        )
        if phase == "running":
            status = replace(status, message="running")
        if stopped is not None:
            rest = {
                "stop peak force (N)": f"{stopped.peak_force:.1f}",
                "stop time (s)": f"{stopped.steps * self._timebase.dt:g}",
            }
            status = replace(status, values={**status.values, **rest})
        margins = self._rig.limits.margins()
        return with_health(status, margins, self._answered_at, self._round_trip.last)

    def _tell_if_due(self) -> None:
        """Tell how the test goes, when its commands are there and there is time for it."""
        if time.monotonic() - self._told_at >= TELL_PERIOD:
            self._shell.note(self._status("running"))

    def _lockstep(self, step: int, is_last: bool) -> str | None:
        """Wait for the commands of a step, and for the recorder; say why the test must end."""
        del is_last
        shell, timeout = self._shell, self._section["lockstep_timeout"]
        while self._recorder_lag.is_large(step) and self._told == "running":
            shell.spin_once(0.05)
            if (why := self._unwanted()) is not None:
                return why
        deadline = time.monotonic() + timeout
        while self._valve.step < step or self._drive.step < step:
            if not shell.spin_once(0.05):
                self._publish_clock(step)  # perhaps there is no ground motion so far ahead
            if (why := self._unwanted()) is not None:
                return why
            if time.monotonic() > deadline:
                late = self._valve if self._valve.step < step else self._drive
                topic, foreign = late.codec.topic, shell.foreign_publishers(self._refused_before)
                text = f"no {topic.name} for step {step} within {timeout:g} s in lockstep"
                return f"{text}; is {topic.publisher} running?{foreign}"
        return None

    def _start_clock(self) -> None:
        """Begin the time of a test in realtime.

        It begins soon after the first answer: the others prepare for a test, and tell of it, when
        they first hear of it. Of several rigs, which begin together, one waits for another that
        is behind: their steps are answered together. Behind links they can't see each other, and
        each makes up for the time it has lost.
        """
        self._waits = not self._is_alone and not self._section["loop_delay"]
        start = time.monotonic() if self._is_alone else self._start
        makes_up = not self._is_alone and not self._waits
        self._clock = SampleClock(self._timebase.dt, start, makes_up=makes_up)

    def _realtime(self, step: int, is_last: bool) -> str | None:
        """Wait for the deadline of the next step; a command that is missing then is counted.

        Say why the test must end, if it must.
        """
        shell, drive, clock = self._shell, self._drive, self._clock
        assert clock is not None
        period, timeout = self._timebase.dt, self._section["watchdog.command_timeout"]
        if step == 0 and self._is_alone:
            clock.fall_back(self._wait_for_answer(0, timeout) + BREATH)
        if step == 0:
            self._watch.begin(elapsed() + clock.deadline(0) - time.monotonic())
        deadline = clock.deadline(step + 1)
        while (left := deadline - time.monotonic()) > 0:
            if shell.spin_once(left) and drive.step >= step:
                self._tell_if_due()
        clock.awake(-left)
        late = time.monotonic() + period
        while drive.step < step and time.monotonic() < late and shell.spin_once(0.0):
            pass  # what came while we were late counts as in time; a flood does not stop us
        if self._waits and drive.step < step:
            clock.fall_back(self._wait_for_answer(step - 1, timeout) + FALL_BACK * period)
        if (why := self._unwanted()) is not None or is_last or self._rig.violation is not None:
            return why
        if drive.step < step:
            self._missed_count += 1
            if len(self._missed) < LISTED_STEPS:
                self._missed.append(step)
                self._held.append(drive.step)
        in_vain = self._waited_in_vain and drive.step < step
        fault = self._watch.fault(elapsed(), step, drive.step, in_vain=in_vain)
        return fault + self._shell.foreign_publishers(self._refused_before) if fault else None

    def _wait_for_answer(self, step: int, longest: float) -> float:
        """Wait for the command of a step; return for how long, s."""
        drive, begun = self._drive, time.monotonic()
        while drive.step < step and time.monotonic() - begun < longest:
            self._shell.spin_once(self._timebase.dt)
            if self._unwanted() is not None:
                break
        self._waited_in_vain = drive.step < step
        return time.monotonic() - begun

    def _publish(self, step: int, state: Floats) -> bool:
        """Publish a sample; False if it is no number, which no message may carry."""
        self._valve.current = self._drive.current = step
        try:
            raw = self._state_codec.encode(step, state)
        except WireError:
            return False
        self._published_at[step % LATEST] = time.monotonic()
        self._publish_state(raw)
        if step % self._clock_steps == 0:
            self._publish_clock(step)
        return True

    def _publish_clock(self, step: int) -> None:
        if self._publish_time is not None:
            restamp(self._time_message, self._timebase.stamp_ns(step))
            self._publish_time(bytes(self._time_message))

    def _unwanted(self) -> str | None:
        """Say why the test must end here, if it must: no rig moves without a supervisor."""
        if self._shell.stopping:
            return "the rig node was told to end"
        if self._fault:
            return self._fault
        if not self._is_moving():
            return STOPPED
        patience = self._section["watchdog.supervisor_timeout"]
        if self._awake.time() - self._heard_at > patience:
            return f"node supervisor has been silent for {patience:g} s"
        return None

    def _on_experiment_state(self, raw: bytes, _: int) -> None:
        """Follow the supervisor; a rig that comes up in the middle of a test stays at rest."""
        status = decode_status(raw)
        self._heard_at = self._awake.time()
        if status.message == self._told:
            return  # a sign of life
        self._told = status.message
        if status.message in MOVING and not (self._armed or self._is_moving()):
            why = "that was running before this rig was ready for it"
            raise WireError("a test " + ("after a trip and no reset" if self._latched else why))
        if status.message == "running" and not status.number("steps"):
            raise WireError("a test that does not say how many steps it has")
        if status.message == "idle":
            self._latched, self._fault = False, ""
        self._armed = status.message == "ready" and not self._latched
        self._wanted = status

    def _is_moving(self) -> bool:
        return self._wanted is not None and self._wanted.message in MOVING


KIND = NodeKind(TABLE, [TABLE], RigNode)
main = KIND.main


if __name__ == "__main__":
    sys.exit(main())
