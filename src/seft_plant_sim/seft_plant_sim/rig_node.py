"""Node ``rig``: it hosts the hardware of a test, simulated or a laboratory's, and guards it.

It publishes rig/state and obeys valve_command (idealised actuators: reference_force). It is
the sampling clock of the test; the supervisor's experiment/state starts and stops it.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.facts import command_unit
from seft_msgs_py.errors import InputError
from seft_msgs_py.node.node_shell import WARM_UP_STEPS, NodeBody, NodeKind, NodeShell
from seft_msgs_py.wire import outcome, topics
from seft_msgs_py.wire.experiment_state import ExperimentState
from seft_msgs_py.wire.messages import ERROR, OK, Status, encode_clock, restamp
from seft_msgs_py.wire.outcome import MissedSteps, Outcome, State, Trip
from seft_msgs_py.wire.trajectory import TrajectoryCodec

from seft_plant_sim import rig_watch
from seft_plant_sim.command import Command
from seft_plant_sim.hardware.hosted import HardwareError, HostedHardware
from seft_plant_sim.hardware.safe_stop import Stopped
from seft_plant_sim.judge.known_rig import command_limit, fastest_command
from seft_plant_sim.rig import Rig
from seft_plant_sim.rig_parameters import RIG_TABLE, SIMULATED
from seft_plant_sim.rig_rest import Rehearsal, RigRest
from seft_plant_sim.rig_watch import rig_report

CLOCK_PERIOD = 0.1  # s of the test's time
BREATH = 0.005  # s from the first answer in realtime to the time of step 0
FALL_BACK = 0.25  # of a period: delay of each next sample of a rig that is ahead of others
_REPORT_PERIOD = 1.0  # s, of the diagnostics of a running test


class RigNode(NodeBody):
    """Runs a `Rig` at its pace and moves its samples and commands between topics.

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
        rig = self._section, experiment.axes, self._timebase, shell.rig
        self._is_realtime = self._section["pace"] == "realtime"
        hosted = self._hosted()
        self._rig = self._fault_free = Rig(*rig, hosted)
        if self._section["faults"] and hosted is None:  # they are of the test alone
            self._fault_free = Rig({**self._section, "faults": ""}, *rig[1:])
        self._is_sampled = hosted is not None and self._is_realtime  # also between two tests
        self._rest = RigRest(
            shell,
            self._rig,
            self._timebase.dt,
            is_sampled=self._is_sampled,
            tell=self._tell,
            at_rest=self._end_stop,
        )
        self._is_alone = len(experiment.rigs) == 1
        self._open_topics()
        self._take_commands()
        self.facts: dict[str, Any] = {"drive": self._drive.codec.topic.name}
        if self._rig.zeroed is not None:
            self.facts[outcome.ZEROED] = self._rig.zeroed
        self._rehearsal: Rehearsal | None = None
        if self._is_alone and self._is_realtime and not self._section["loop_delay"]:
            obeyed, fault_free = self._drive, self._fault_free
            self._rehearsal = Rehearsal(shell, self._timebase, obeyed, fault_free, self._is_sampled)
            self.facts[outcome.REHEARSES] = True
        self._watch_others()
        self._measured: list[Floats] = []  # samples that have not been sent
        self._step = 0  # of the test's last sample; a laboratory's rig is sampled on
        self._stop_begun: int | None = None  # step of the trip from which the force ramps down
        self._reported_at = self._answered_at = 0.0
        self._refused_before = 0  # messages, until the newest command came
        self._rehearsed = False
        self._is_idle = True  # no test has been performed since the last reset
        self._ended: tuple[str, Trip | None] | None = None  # the test whose stop is under way
        self._warm_up()

    def _open_topics(self) -> None:
        """Make the publishers of what the rig measures, and of the test's clock."""
        shell = self._shell
        state, measured = topics.RIG_STATE.of(shell.rig), topics.MEASURED.of(shell.rig)
        self._state_codec = TrajectoryCodec(state, shell.rig.axes, self._timebase)
        self._measured_codec = TrajectoryCodec(measured, shell.rig.axes, self._timebase)
        self._publish_state = shell.publisher(state)
        self._publish_measured = shell.publisher(measured)
        # with several rigs, one is the test's clock, and all start together
        self._publish_time: Callable[[bytes], None] | None = None
        if shell.rig.axes[0] == shell.experiment.axes[0]:
            self._publish_time = shell.publisher(topics.CLOCK_TOPIC)
        self._time_message = bytearray(encode_clock(0))

    def _take_commands(self) -> None:
        """Subscribe to what the rig obeys, and to the stop that it may follow."""
        shell = self._shell
        self._round_trip, self._compute = rig_watch.RoundTrip(), rig_watch.RoundTrip()
        valve, largest = topics.VALVE_COMMAND.of(shell.rig), command_limit(self._section)
        self._valve = self._drive = self._command(valve, shell.rig.axes, largest)
        if self._rig.drive == topics.REFERENCE_FORCE.name:
            delay, largest_force = self._section["loop_delay"], self._section["limits.force"]
            axes = shell.experiment.axes
            self._drive = self._command(topics.REFERENCE_FORCE, axes, largest_force, max(delay, 0))
        fallback_stop = topics.STOP_COMMAND.of(shell.rig)
        self._fallback_stop = self._command(fallback_stop, shell.rig.axes, largest)

    def _watch_others(self) -> None:
        """Watch supervisor and recorder, and whether commands come."""
        section, clock = self._section, self._clock
        self._supervision = rig_watch.Supervision(section["watchdog.supervisor_timeout"], clock)
        self._shell.subscribe(topics.EXPERIMENT_STATE, self._follow, depth=16)
        self._recorder_lag = rig_watch.RecorderLag(section["lockstep_timeout"], clock)
        if section["pace"] == "lockstep":
            self._shell.subscribe(topics.DIAGNOSTICS, self._recorder_lag.receive)
        self._samples: rig_watch.SampleClock | None = None  # of a test in realtime
        topic, timeout = self._drive.codec.topic, section["watchdog.command_timeout"]
        self._watch = rig_watch.CommandWatch(topic, self._timebase.dt, timeout)
        self._clock_steps = max(1, round(CLOCK_PERIOD * self._timebase.rate))

    def _hosted(self) -> HostedHardware | None:
        """Make the laboratory's hardware, if there is one."""
        if self._section["hardware"] == SIMULATED:
            return None
        shell, period, now = self._shell, self._timebase.dt, self._clock.monotonic
        made = HostedHardware(self._section, shell.experiment.axes, shell.rig, period, now)
        if not (self._is_realtime or made.can_wait):
            why = f"hardware {self._section['hardware']} can't wait for a command"
            raise InputError(f"rig: pace is lockstep, but {why}; make pace realtime")
        return made

    def _warm_up(self) -> None:
        shape = len(topics.RIG_STATE.quantities), len(self._shell.rig.axes)
        for step in range(WARM_UP_STEPS):
            sample, measured = np.zeros(shape), np.zeros((4, shape[1]))
            self._rig.guard.take(step, measured, sample[0], sample)
            self._state_codec.decode(self._state_codec.encode(step, sample))
            self._measured_codec.encode_points(step, np.array([measured] * topics.MEASURED_STEPS))
        self._rig.begin()

    def run(self) -> None:
        """Run a test each time the supervisor starts one, until the process ends."""
        supervision, rest, hardware = self._supervision, self._rest, self._rig.hardware
        rest.attempt(hardware.safe)
        self._tell(rest.failure)
        try:
            while not self._shell.stopping:
                rest.turn()
                wanted = supervision.wanted
                self._rehearsed &= supervision.rehearsal > 0  # a new request gets a new rehearsal
                if wanted is not None and supervision.is_moving:
                    self._is_idle = False
                    self._run_test(wanted)
                    if supervision.is_moving:
                        supervision.wanted = None  # a test runs once
                elif self._rehearsal is not None and supervision.rehearsal and not self._rehearsed:
                    rest.attempt(partial(self._rehearse, self._rehearsal))
                elif not self._is_idle and wanted is not None and wanted.state == "idle":
                    self._is_idle = True  # by now others know how the test ended
                    self._tell(rest.failure)
            while hardware.is_closing:
                self._clock.sleep(self._timebase.dt)
                rest.sample()
        finally:
            rest.attempt(hardware.close)

    def _tell(self, failure: str) -> None:
        """Report what is wrong with the hardware between two tests; empty: nothing."""
        if self._is_idle:
            level, waits = (ERROR, {outcome.WAITS: failure}) if failure else (OK, None)
            self.report("idle", waits, level, failure)

    def _end_stop(self, stopped: Stopped) -> None:
        """Report how a test ended whose stop went on after it."""
        if self._ended is not None:
            self._report(*self._ended, stopped)
            self._ended = None

    def _rehearse(self, rehearsal: Rehearsal) -> None:
        """Run the loop with the valve at its safe value, and publish the result."""
        wanted = self._supervision
        zeroing = round(wanted.zeroing / self._timebase.dt)
        facts = rehearsal.run(
            wanted.rehearsal, zeroing, lambda: self._shell.stopping or not wanted.rehearsal
        )
        if facts:  # it was not interrupted
            self._rehearsed = True
            self._shell.add_facts(facts)

    def _follow(self, raw: bytes, received_ns: int) -> None:
        """Follow the supervisor, and note where the force begins to ramp down."""
        self._supervision.receive(raw, received_ns)
        wanted = self._supervision.wanted
        if wanted is not None and wanted.state == State.RAMPING_DOWN and self._stop_begun is None:
            step = wanted.step
            self._stop_begun = self._rig.step_index if step is None else step

    def fault(self, reason: str) -> None:
        """End the running test, or the next one, until the operator resets."""
        self._supervision.fault = reason

    def _command(
        self, topic: topics.LoopTopic, axes: tuple[str, ...], limit: float, loop_delay: int = 0
    ) -> Command:
        codec = TrajectoryCodec(topic, axes, self._timebase)
        rig = None if axes == self._shell.rig.axes else self._shell.rig
        is_plan = topic.units == topics.VALVE_COMMAND.units
        command = Command(codec, limit, loop_delay, rig, is_plan=is_plan)
        if is_plan:
            command.unit = command_unit(self._section["actuator.kind"])
            command.fastest = fastest_command(self._section, self._timebase.dt)

        def receive(raw: bytes, _: int) -> None:
            command.take(raw)
            if command is self._drive:
                self._answered_at = self._clock.monotonic()
                self._refused_before = self._shell.refused
                self._round_trip.answered(command, self._answered_at)

        self._shell.subscribe(topic, receive, reliable=False)
        return command

    def _run_test(self, wanted: ExperimentState) -> None:
        for command in (self._valve, self._drive, self._fallback_stop):
            command.reset()
        self._stop_begun = None
        self._missed = MissedSteps(self._timebase.rate)
        self._measured.clear()
        self._samples, self._step = None, 0
        self._recorder_lag.reset()
        self._round_trip.reset()
        self._compute.reset()
        self._answered_at = self._reading = 0.0
        self._waited_in_vain = False
        self._refused_before = self._shell.refused
        self._started = self._clock.monotonic()
        self._rig.begin()
        self._report("running")
        reason = self._shell.senders.conflict() or self._start_together(wanted)
        try:
            if reason:
                self._publish(0, self._rig.read(), self._started)
            else:
                reason = self._supervision.fault or self._run_steps(wanted.steps or 0)
        except HardwareError as error:
            reason = reason or str(error)
        except Exception as error:  # a fault of the program ends the test as a limit does
            reason = self._shell.fault("a step", error)
        step = self._step
        self._send_measured()
        self._publish_clock(step)
        trip, phase = None, outcome.FINISHED
        if reason is not None:
            self._supervision.latched, phase = True, outcome.TRIPPED
            waited = 0.0 if self._rig.violation else self._watch.waited
            trip = Trip(reason, step, self._timebase.stamp_ns(step) / 1e9, waited)
        stopped = self._rest.attempt(lambda: self._rig.stop(*(self._plan() if trip else ())))
        self._report(phase, trip, stopped)
        self._ended = (phase, trip) if stopped is None else None
        self._rest.due = self._clock.monotonic() + self._timebase.dt

    def _run_steps(self, steps: int) -> str | None:
        """Take the samples of a test at its pace; say why it ended early, if it did."""
        rig, wait = self._rig, self._wait_for_answers
        if self._is_realtime:
            self._begin_realtime()
            wait = self._wait_for_deadline
        for step in range(steps):
            begun = self._clock.monotonic()
            sample = rig.read()  # calibrated, aligned, judged
            if rig.hardware.is_clock and self._samples is not None:
                now = self._clock.monotonic()
                self._samples.follow(step, now)
                begun, self._reading = now, now - begun
            self._publish(step, sample, begun)
            if self._stops_before(step):
                rig.violation = None  # the controller brings the rig to rest
            is_last = step + 1 == steps
            why = wait(step, is_last)  # in realtime not after a violation
            if why is not None or rig.violation is not None:
                return rig.violation or why
            if not is_last:
                rig.write(self._next_command(step))
        return None

    def _begin_realtime(self) -> None:
        """Begin to sample by the clock.

        Several rigs in realtime begin together; one waits for another that is behind, because
        their steps are answered together, but a controller that is the clock can't. Over links
        they can't see each other: each makes up for lost time.
        """
        linked = bool(self._section["loop_delay"])
        self._waits = not (self._is_alone or linked or self._rig.hardware.is_clock)
        makes_up = linked and not self._is_alone
        start = self._clock.monotonic() if self._is_alone else self._start
        self._samples = rig_watch.SampleClock(self._timebase.dt, start, makes_up=makes_up)

    def _stops_before(self, step: int) -> bool:
        """Say whether the controller has begun to bring the rig to rest before a step."""
        begun = self._drive.stops_since
        if begun is not None and self._stop_begun is None:
            self._stop_begun = begun
        return begun is not None and begun < step

    def _next_command(self, step: int) -> Floats:
        """Give the command of a step; where it is missing, that of the fallback stop.

        Without a fallback stop, the last command is held. A stop begins with the motion of the
        test, so that little is lost until the next command comes.
        """
        command, last = self._drive.value, self._drive.step
        if last >= step:
            return command
        if self._drive is self._valve and self._valve.stops_since is None:
            stop = self._fallback_stop.newest
            command = self._rig.extrapolated_command(command, *stop, step - last)
        return command

    def _plan(self) -> tuple[Floats | None, ...]:
        """Give the stop that the controller has sent, for a rig with valves, see `Rig.stop`."""
        if self._drive is not self._valve:
            return ()
        if self._valve.stops_since is None:
            return self._fallback_stop.plan(self._rig.trusted)
        return self._valve.plan(self._valve.current)[:1]

    def _start_together(self, wanted: ExperimentState) -> str | None:
        """Wait for the moment at which all rigs start; give the reason if they can't.

        After that each rig samples by its own clock, so the clocks must agree.
        """
        if self._is_alone or self._section["pace"] == "lockstep":
            return None
        try:
            ahead = wanted.until_start(self._clock.time_ns())
        except InputError as error:
            return str(error)
        self._start = self._clock.monotonic() + ahead
        while (left := self._start - self._clock.monotonic()) > 0:
            self._rest.turn(left)
            if (why := self._reason_to_end()) is not None:
                return why
        return None

    def _report(self, phase: str, trip: Trip | None = None, stopped: Stopped | None = None) -> None:
        self._shell.report(self._status(phase, trip, stopped))

    def _status(
        self, phase: str, trip: Trip | None = None, stopped: Stopped | None = None
    ) -> Status:
        now = self._reported_at = self._clock.monotonic()
        missed, overruns = self._missed, self._samples.overruns if self._samples else 0
        taken = self._step + 1, len(missed.steps), missed.steps, now - self._started
        seen = overruns, self._rig.saturation, self._round_trip.numbers()
        true = stopped and self._rig.simulated(self._stop_begun)
        result = Outcome(phase, *taken, trip, *seen, true, missed.most)
        age = now - self._answered_at if self._answered_at else math.nan
        return rig_report(result, self._rig, self._compute, self._round_trip, age, stopped)

    def _report_if_due(self, later: float = 0.0) -> None:
        """Report the test's progress, by default where there is time for it; times in s."""
        if self._clock.monotonic() - self._reported_at >= _REPORT_PERIOD + later:
            self._shell.note(self._status("running"))

    def _wait_for_answers(self, step: int, is_last: bool) -> str | None:
        """Wait for the commands of a step, and for the recorder; give a reason to end the test."""
        del is_last
        shell, timeout = self._shell, self._section["lockstep_timeout"]
        while self._recorder_lag.is_large(step) and self._supervision.state == "running":
            shell.spin_once(0.05)
            if (why := self._reason_to_end()) is not None:
                return why
        deadline = self._clock.monotonic() + timeout
        while self._valve.step < step or self._drive.step < step:
            if not shell.spin_once(0.05):
                self._publish_clock(step)  # the ground motion may need the time to continue
            if (why := self._reason_to_end()) is not None:
                return why
            if self._clock.monotonic() > deadline:
                late = self._valve if self._valve.step < step else self._drive
                topic = late.codec.topic
                unexpected = shell.name_unexpected_publishers(self._refused_before)
                text = f"no {topic.name} for step {step} within {timeout:g} s in lockstep"
                return f"{text}; is {topic.publisher} running?{unexpected}"
        self._report_if_due()
        return None

    def _wait_for_deadline(self, step: int, is_last: bool) -> str | None:
        """Wait for the deadline of the next step, and count a missing command.

        Gives the reason if the test must end; after a violation at once.
        """
        drive, clock = self._drive, self._samples
        assert clock is not None
        if self._rig.violation is not None:
            return None
        timeout = self._section["watchdog.command_timeout"]
        if step == 0 and self._is_alone:  # the other nodes prepare at the first sample
            clock.fall_back(self._wait_for_answer(0, timeout) + BREATH)
        if step == 0:
            self._watch.begin(self._clock.elapsed() + clock.deadline(0) - self._clock.monotonic())
        if self._rig.hardware.is_clock:  # the answer goes out at once
            left, shell = clock.deadline(step + 1) - self._clock.monotonic(), self._shell
            rig_watch.wait_for_command(shell, drive, step, left, self._reason_to_end)
            self._report_if_due()
        else:
            rig_watch.wait_for_sample(self._shell, drive, step, clock, self._report_if_due)
        if self._waits and drive.step < step:
            clock.fall_back(self._wait_for_answer(step - 1, timeout) + FALL_BACK * clock.period)
        if (why := self._reason_to_end()) is not None or is_last:
            return why
        if drive.step < step:
            self._missed.add(step)
            self._report_if_due(_REPORT_PERIOD / 2)  # though there is no spare time
        in_vain = self._waited_in_vain and drive.step < step
        now, reading = self._clock.elapsed(), self._reading
        why = self._watch.fault(now, step, drive.step, in_vain=in_vain, reading=reading)
        return why + self._shell.name_unexpected_publishers(self._refused_before) if why else None

    def _wait_for_answer(self, step: int, longest: float) -> float:
        """Wait for the command of a step; return for how long, s."""
        shell, drive, stop = self._shell, self._drive, self._reason_to_end
        waited = rig_watch.wait_for_command(shell, drive, step, longest, stop)
        self._waited_in_vain = drive.step < step
        return waited

    def _publish(self, step: int, sample: Floats, begun: float) -> None:
        """Publish a sample whose reading began at a time in s; then it as measured."""
        self._step = step
        self._valve.current = self._drive.current = self._fallback_stop.current = step
        raw = self._state_codec.encode(step, sample)
        now = self._clock.monotonic()
        self._compute.add(now - begun)
        self._round_trip.published(step, now)
        self._publish_state(raw)
        self._measured.append(self._rig.measured)
        if len(self._measured) == topics.MEASURED_STEPS:
            self._send_measured()
        if step % self._clock_steps == 0:
            self._publish_clock(step)

    def _send_measured(self) -> None:
        """Send the samples as measured that have not been sent."""
        if self._measured:
            first = self._step + 1 - len(self._measured)
            raw = self._measured_codec.encode_points(first, np.array(self._measured))
            self._publish_measured(raw)
            self._measured.clear()

    def _publish_clock(self, step: int) -> None:
        if self._publish_time is not None:
            restamp(self._time_message, self._timebase.stamp_ns(step))
            self._publish_time(bytes(self._time_message))

    def _reason_to_end(self) -> str | None:
        """Give the reason why the test must end here, if there is one."""
        if self._shell.stopping:
            return "the rig node received a signal to end"
        return self._supervision.reason_to_end()


RIG_NODE = NodeKind(RIG_TABLE, [RIG_TABLE], RigNode)
main = RIG_NODE.main


if __name__ == "__main__":
    raise SystemExit(main())
