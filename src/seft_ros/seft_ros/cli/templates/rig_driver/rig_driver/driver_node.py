"""Node ``rig``: a laboratory's rig behind the topics of a test.

It samples at absolute deadlines as long as it lives, and publishes rig/state while the
supervisor says so. docs/hardware.md of seft has the contract; `seft conform` checks it.
"""

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.parameter_table import group, per_axis
from seft_msgs_py.errors import InputError, WireError
from seft_msgs_py.node.node_shell import NodeBody, NodeKind, NodeShell
from seft_msgs_py.node.realtime import AwakeClock
from seft_msgs_py.wire.messages import ERROR, OK, Status, decode_status, encode_clock
from seft_msgs_py.wire.outcome import (
    FINISHED,
    LISTED_STEPS,
    MOVING,
    REHEARSED,
    REHEARSES,
    STOPPED,
    TRIPPED,
    Outcome,
    Trip,
    rig_status,
)
from seft_msgs_py.wire.topics import (
    CLOCK_TOPIC,
    EXPERIMENT_STATE,
    REHEARSE,
    RIG_STATE,
    VALVE_COMMAND,
    until_start,
)
from seft_msgs_py.wire.trajectory import TrajectoryCodec
from seft_plant_sim.command import Command
from seft_plant_sim.limits import Limits
from seft_plant_sim.rig_watch import CommandWatch, Rehearsal, elapsed

from rig_driver.calibration import Calibration
from rig_driver.hardware import Hardware
from rig_driver.parameters import TABLE
from rig_driver.rest import Rest
from rig_driver.safe_stop import SafeStop
from rig_driver.stand_in import StandIn

GOES_ON = 0.05
"""Part of the largest displacement that a piston may move after its valve was closed."""
CLOCK_PERIOD = 0.1  # s between two messages of /clock


class DriverNode(NodeBody):
    """Moves samples and commands between a `Hardware` and the topics of a test.

    Parameters
    ----------
    shell : NodeShell
        Node and parameters.
    hardware : Hardware
        The rig.
    """

    def __init__(self, shell: NodeShell, hardware: Hardware) -> None:
        experiment = shell.experiment
        super().__init__(shell)
        self._hardware = hardware
        self._section, self._timebase = experiment["rig"], experiment.timebase
        # one of several rigs has its own part of the axes (docs/hosts.md)
        rig, section = shell.rig, self._section
        axes = rig.axes
        self._calibration = Calibration.from_parameters(group(section, "calibration"), axes)
        self._limits = Limits(group(section, "limits"), axes, self._timebase.dt)
        self._rest = Rest(section["safe.rest_velocity"], self._timebase.dt)
        at = per_axis(section["safe.valve_command"], axes, "rig: safe.valve_command")
        farthest = GOES_ON * section["limits.displacement"]
        closing, dt = section["safe.close_time"], self._timebase.dt
        self._stop = SafeStop(hardware, np.asarray(at), closing, farthest, dt)
        self._states = TrajectoryCodec(RIG_STATE.of(rig), axes, self._timebase)
        commands = TrajectoryCodec(VALVE_COMMAND.of(rig), axes, self._timebase)
        self._command = Command(commands, section["limits.command"])
        timeout = section["watchdog.command_timeout"]
        self._watch = CommandWatch(commands.topic, self._timebase.dt, timeout)
        self.facts: dict[str, Any] = {"drive": commands.topic.name}
        self._rehearsal: Rehearsal | None = None
        self._rehearses_for = 0.0  # s, as the supervisor says; 0: it does not ask
        self._rehearsed = False
        if not rig.name:
            limit = section["limits.command"]
            self._rehearsal = Rehearsal(shell, self._timebase, commands.topic, limit)
            self.facts[REHEARSES] = True
        self._publish_state = shell.publisher(self._states.topic)
        self._tells_time = axes[0] == experiment.axes[0]  # one rig does
        if self._tells_time:
            self._publish_clock = shell.publisher(CLOCK_TOPIC)
        shell.subscribe(commands.topic, lambda raw, _: self._command.take(raw), reliable=False)
        shell.subscribe(EXPERIMENT_STATE, self._on_experiment_state, depth=16)
        self._awake = AwakeClock()
        self._received_at = self._awake.time()
        self._told = ""  # state of the test, as the supervisor says
        self._armed = False  # it was ready, and no trip has been since
        self._steps = 0  # of a test that is to begin; 0: none is
        self._start = 0.0  # s, monotonic: not before
        self._phase = "idle"
        self._overruns = 0
        self._status = Status("rig", OK, "idle", values={"phase": "idle"})
        self._resting: bool | None = None  # None: nobody looks
        self._limits.violation(np.zeros((4, len(axes))))  # the first call takes longest

    def run(self) -> None:
        """Sample until told to stop."""
        self._hardware.to_safe_position()
        self._shell.report(self._status)
        period = self._timebase.dt
        deadline = time.monotonic() + period
        try:
            while not self._shell.stopping:
                self._shell.spin_once(max(deadline - time.monotonic(), 0.0))  # also when late
                while (left := deadline - time.monotonic()) > 0:
                    self._shell.spin_once(left)
                late = int((time.monotonic() - deadline) / period)
                if late:  # held up for more than a period: go on from here, without hurry
                    self._overruns += self._phase == "running"
                deadline += (1 + late) * period
                self._shell.attempt("a sample", self._tick)
                if self._rehearsal is not None and self._rehearses_for and not self._rehearsed:
                    self._rehearse(self._rehearsal)
                    deadline = time.monotonic() + period
            if self._phase == "running":
                self._end("the rig node received a signal to end")
                self._stop.finish()
        finally:
            self._hardware.to_safe_position()
            self._hardware.close()

    def fault(self, reason: str) -> None:
        """Bring the rig to its safe position, whatever it is in, and end a test that runs."""
        if self._phase == "running":
            self._end(reason)
        self._stop.at_once()

    def _tick(self) -> None:
        """Take one sample, and do with it what the phase asks for."""
        if self._phase == "running" and self._goes_on():
            self._hardware.write_command(self._command.value)
        sample = self._calibration.to_si(self._hardware.read_sample())
        if self._phase == "running":
            self._publish(self._step + 1, sample)
        elif self._steps and self._told in MOVING and time.monotonic() >= self._start:
            self._begin(sample)
        else:
            self._stop.follow(sample[0])
            self._follow_to_rest(sample)

    def _rehearse(self, rehearsal: Rehearsal) -> None:
        """Run the loop at its rate with the valve at its safe value, which obeys no command."""

        def sample(_: int) -> Floats:
            found = self._calibration.to_si(self._hardware.read_sample())
            self._stop.follow(found[0])
            return found

        def stopped() -> bool:
            return self._shell.stopping or not self._rehearses_for

        found = rehearsal.run(self._rehearses_for, sample, stopped)
        if self._rehearses_for:
            self._rehearsed = True
            self._shell.add_facts({REHEARSED: found})

    def _begin(self, sample: Floats) -> None:
        self._total, self._steps = self._steps, 0
        self._phase, self._step, self._overruns = "running", -1, 0
        self._missed: list[int] = []
        self._missed_count = 0
        self._resting = None
        self._command.reset()
        self._limits.reset()
        self._started = time.monotonic()
        self._clock_at = -CLOCK_PERIOD
        self._step = 0
        self._report("running")
        if conflict := self._shell.several_senders():
            self._step = 0
            self._end(conflict)
            return
        self._publish(0, sample)
        self._watch.begin(elapsed())  # nothing has moved before

    def _publish(self, step: int, sample: Floats) -> None:
        self._step = self._command.current = step
        violation = self._limits.violation(sample)
        try:
            self._publish_state(self._states.encode(step, sample))
        except WireError as error:
            violation = violation or str(error)
        now = time.monotonic()
        if self._tells_time and now - self._clock_at >= CLOCK_PERIOD:
            self._clock_at = now
            self._publish_clock(encode_clock(self._timebase.stamp_ns(step)))
        if violation:
            self._end(violation)

    def _goes_on(self) -> bool:
        """Look at the end of a period whether the test goes on; if not, it has been ended."""
        step, section = self._step, self._section
        patience = section["watchdog.supervisor_timeout"]
        if self._told not in MOVING:
            self._end(STOPPED)
        elif self._awake.time() - self._received_at > patience:
            self._end(f"node supervisor has been silent for {patience:g} s")
        elif step + 1 == self._total:
            self._end(None)
        else:
            if self._command.step < step:
                self._missed_count += 1
                if len(self._missed) < LISTED_STEPS:
                    self._missed.append(step)
            self._look_after_commands(step)
        return self._phase == "running"

    def _look_after_commands(self, step: int) -> None:
        """End a test that has been without a new command, also while this process was stopped."""
        if fault := self._watch.fault(elapsed(), step, self._command.step):
            self._end(fault)

    def _end(self, reason: str | None) -> None:
        """End a test: the rig comes to rest whatever the reason; None if all steps are done."""
        self._stop.begin(self._command.value)
        self._phase = FINISHED if reason is None else TRIPPED
        self._armed = False
        self._rest.begin()
        self._resting = False
        step = max(self._step, 0)
        trip = Trip(reason, step, self._timebase.stamp_ns(step) / 1e9) if reason else None
        self._report(self._phase, trip)

    def _follow_to_rest(self, sample: Floats) -> None:
        if self._resting is not False:
            return
        values = {}
        if self._rest.is_reached(sample):
            self._resting = True
            values["stop time (s)"] = f"{self._rest.time:.4g}"
            values["stop peak force (N)"] = f"{self._rest.peak_force:.1f}"
        elif self._rest.time > self._section["safe.settle_time"]:
            self._resting = None
            text = f"{self._status.message}; not at rest after {self._rest.time:.3g} s"
            text += ", the pressure was dumped" if self._stop.has_dumped else ""
            self._status = replace(self._status, level=ERROR, message=text)
        else:
            return
        self._status = replace(self._status, values={**self._status.values, **values})
        self._shell.report(self._status)

    def _report(self, phase: str, trip: Trip | None = None) -> None:
        wall = time.monotonic() - self._started
        count, missed = self._missed_count, self._missed
        outcome = Outcome(phase, self._step + 1, count, missed, wall, trip, self._overruns)
        self._status = rig_status(outcome)
        self._shell.report(self._status)

    def _on_experiment_state(self, raw: bytes, _: int) -> None:
        """Follow the supervisor; a test that was not ready before does not move this rig."""
        status = decode_status(raw)
        self._received_at = self._awake.time()
        self._rehearses_for = status.number(REHEARSE) or 0.0
        self._rehearsed &= self._rehearses_for > 0  # who asks anew gets a new one
        if status.message == self._told:
            return  # a sign of life
        self._told = status.message
        if status.message == "idle" and self._phase != "running":
            self._phase, self._resting = "idle", None  # how the last test ended has been told
            self._status = Status("rig", OK, "idle", values={"phase": "idle"})
            self._shell.report(self._status)
        if status.message == "ready" and self._phase == "idle":
            self._armed = True
        elif status.message == "running":
            steps = status.values.get("steps", "")
            if not (self._armed and steps.isdecimal() and int(steps)):
                raise WireError("a test that this rig was not ready for, or without its steps")
            try:
                ahead = until_start(status.values)  # together with other rigs
            except InputError as error:
                raise WireError(str(error)) from None
            self._armed = False
            self._steps, self._start = int(steps), time.monotonic() + ahead


def serve(make: Callable[[NodeShell], Hardware]) -> int:
    """Run the driver of some hardware; return the exit status."""
    return NodeKind(TABLE, [TABLE], lambda shell: DriverNode(shell, make(shell))).main()


def stand_in(shell: NodeShell) -> StandIn:
    """Make the stand-in; put your own hardware here."""
    experiment = shell.experiment
    safe = experiment["rig"]["safe.valve_command"]
    at = per_axis(safe, shell.rig.axes, "rig: safe.valve_command")
    return StandIn(experiment.timebase.rate, shell.rig.axes, np.asarray(at))


def main() -> int:
    """Entry point of ``ros2 run rig_driver rig``."""
    return serve(stand_in)


if __name__ == "__main__":
    sys.exit(main())
