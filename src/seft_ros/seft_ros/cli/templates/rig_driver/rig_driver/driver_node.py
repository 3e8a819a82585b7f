"""Node ``rig``: a laboratory's rig behind the topics of a test.

It samples at absolute deadlines as long as it lives, and publishes rig/state while the
supervisor says so. docs/hardware.md of seft has the contract; `seft conform` checks it.
"""

import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.parameter_table import group, per_axis
from seft_msgs_py.errors import InputError, WireError
from seft_msgs_py.node.node_kind import NodeKind
from seft_msgs_py.node.node_shell import NodeBody, NodeShell
from seft_msgs_py.wire.messages import ERROR, encode_clock
from seft_msgs_py.wire.outcome import (
    FINISHED,
    REHEARSED,
    REHEARSES,
    TRIPPED,
    ZEROED,
    Outcome,
    Trip,
    rig_status,
)
from seft_msgs_py.wire.topics import (
    CLOCK_TOPIC,
    EXPERIMENT_STATE,
    RIG_STATE,
    VALVE_COMMAND,
    until_start,
)
from seft_msgs_py.wire.trajectory import TrajectoryCodec
from seft_plant_sim.calibration import calibrate, calibration_of, zeroed_at_rest
from seft_plant_sim.command import Command
from seft_plant_sim.limits import Limits
from seft_plant_sim.rig_watch import CommandWatch, Rehearsal, Supervision

from rig_driver.hardware import Hardware
from rig_driver.parameters import TABLE
from rig_driver.rest import Rest
from rig_driver.safe_stop import SafeStop
from rig_driver.stand_in import StandIn
from rig_driver.volts import Volts

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
        super().__init__(shell)
        experiment, rig = shell.experiment, shell.rig
        axes = rig.axes  # one of several rigs has its own part of them (docs/hosts.md)
        self._hardware = hardware
        self._section, self._timebase = experiment["rig"], experiment.timebase
        section, dt = self._section, self._timebase.dt
        self._volts = Volts(group(section, "volts"), axes)
        self._axes = axes
        self._know(section)
        self._limits = Limits(group(section, "limits"), axes, dt)
        self._rest = Rest(section["safe.rest_velocity"], dt)
        at = per_axis(section["safe.valve_command"], axes, "rig: safe.valve_command")
        farthest = GOES_ON * section["limits.displacement"]
        close_time, sleep = section["safe.close_time"], self._clock.sleep
        self._stop = SafeStop(hardware, at, close_time, farthest, dt, sleep)
        self._states = TrajectoryCodec(RIG_STATE.of(rig), axes, self._timebase)
        commands = TrajectoryCodec(VALVE_COMMAND.of(rig), axes, self._timebase)
        topic, limit = commands.topic, section["limits.command"]
        self._command = Command(commands, limit)
        self._watch = CommandWatch(topic, dt, section["watchdog.command_timeout"])
        self._supervision = Supervision(section["watchdog.supervisor_timeout"], self._clock)
        self.facts: dict[str, Any] = {"drive": topic.name}
        self._rehearsal: Rehearsal | None = None
        self._rehearsed = False
        if not rig.name:
            self._rehearsal = Rehearsal(shell, self._timebase, topic, limit)
            self.facts[REHEARSES] = True
        self._publish_state = shell.publisher(self._states.topic)
        tells_time = axes[0] == experiment.axes[0]  # one rig does
        self._publish_clock = shell.publisher(CLOCK_TOPIC) if tells_time else None
        shell.subscribe(topic, lambda raw, _: self._command.take(raw), reliable=False)
        shell.subscribe(EXPERIMENT_STATE, self._on_experiment_state, depth=16)
        self._start = 0.0  # s, monotonic: a test that is to begin does not before
        self._phase = "idle"
        self._overruns = 0
        self._comes_to_rest = False
        rest = np.zeros((4, len(axes)))  # the first calls take longest
        self._limits.violation(rest)
        self._align(rest)

    def run(self) -> None:
        """Sample until asked to stop."""
        self._hardware.to_safe_command()
        self.report("idle")
        period = self._timebase.dt
        now = self._clock.monotonic
        deadline = now() + period
        try:
            while not self._shell.stopping:
                self._shell.spin_once(max(deadline - now(), 0.0))  # also when late
                while (left := deadline - now()) > 0:
                    self._shell.spin_once(left)
                late = int((now() - deadline) / period)
                if late:  # held up for more than a period: go on from here, without hurry
                    self._overruns += self._phase == "running"
                deadline += (1 + late) * period
                self._shell.attempt("a sample", self._tick)
                wanted = self._supervision.rehearsal
                self._rehearsed &= wanted > 0  # who asks anew gets a new one
                if self._rehearsal is not None and wanted and not self._rehearsed:
                    self._rehearse(self._rehearsal, wanted)
                    deadline = now() + period
            if self._phase == "running":
                self._end("the rig node received a signal to end")
                self._stop.finish()
        finally:
            self._hardware.to_safe_command()
            self._hardware.close()

    def fault(self, reason: str) -> None:
        """Bring the rig to its safe command, whatever it is in, and end a test that runs."""
        if self._phase == "running":
            self._end(reason)
        self._stop.at_once()

    def _tick(self) -> None:
        """Take one sample, and do with it what the phase asks for."""
        if self._phase == "running" and self._goes_on():
            self._drive = self._command.value
            self._hardware.write_command(self._drive)
        sample = self._read()
        if self._phase == "running":
            self._publish(self._step + 1, sample)
        elif self._supervision.is_moving and self._clock.monotonic() >= self._start:
            self._begin(sample)
        else:
            self._stop.follow(sample[0])
            self._follow_to_rest(sample)

    def _read(self) -> Floats:
        """Read a sample, (4, n), in SI units and with its channels aligned to the latest one."""
        sample = self._volts.to_si(self._hardware.read_sample())
        self._align(sample)
        return sample

    def _know(self, section: dict[str, Any]) -> None:
        """Begin to align and correct samples by what a section knows of the channels."""
        axes, dt, step = self._axes, self._timebase.dt, self._volts.resolution
        self._alignment = calibration_of(section, axes, range(len(axes)), dt, resolution=step)
        self._read_so_far = 0

    def _zero(self, resting: list[Floats]) -> dict[str, Any] | None:
        """Take biases from samples at rest, if there are any; give what the description says."""
        section, found, places = self._section, None, range(len(self._axes))
        if resting:
            section, found = zeroed_at_rest(section, self._axes, places, np.array(resting))
        self._know(section)
        return found

    def _align(self, sample: Floats) -> None:
        known, state = self._alignment
        if len(known.bias):
            calibrate(known, state, self._read_so_far, sample, sample)
            self._read_so_far += 1

    def _rehearse(self, rehearsal: Rehearsal, seconds: float) -> None:
        """Run the loop at its rate with the valve at its safe value, which obeys no command."""
        resting: list[Floats] = []

        def sample(_: int) -> Floats:
            found = self._volts.to_si(self._hardware.read_sample())
            resting.append(found.copy())
            self._align(found)
            self._stop.follow(found[0])
            return np.vstack([found, np.zeros(len(self._axes))])

        def stopped() -> bool:
            return self._shell.stopping or not self._supervision.rehearsal

        found = rehearsal.run(seconds, sample, stopped)
        if self._supervision.rehearsal:  # it was not interrupted
            self._rehearsed = True
            last = round(self._supervision.zeroing / self._timebase.dt)
            zeroed = self._zero(resting[-last:] if last else [])
            self._shell.add_facts({REHEARSED: found, ZEROED: zeroed})

    def _begin(self, sample: Floats) -> None:
        self._total = self._supervision.wanted.number("steps")
        self._phase, self._step, self._overruns = "running", 0, 0
        self._missed: list[int] = []
        self._comes_to_rest = False
        self._command.reset()
        self._drive = self._command.value
        self._limits.reset()
        self._started = self._clock.monotonic()
        self._clock_at = -CLOCK_PERIOD
        self._report("running")
        if conflict := self._shell.several_senders():
            self._end(conflict)
            return
        self._publish(0, sample)
        self._watch.begin(self._clock.elapsed())  # nothing has moved before

    def _publish(self, step: int, sample: Floats) -> None:
        self._step = self._command.current = step
        violation = self._limits.violation(sample)
        try:
            self._publish_state(self._states.encode(step, np.vstack([sample, self._drive])))
        except WireError as error:
            violation = violation or str(error)
        now = self._clock.monotonic()
        if self._publish_clock and now - self._clock_at >= CLOCK_PERIOD:
            self._clock_at = now
            self._publish_clock(encode_clock(self._timebase.stamp_ns(step)))
        if violation:
            self._end(violation)

    def _goes_on(self) -> bool:
        """Look at the end of a period whether the test goes on; if not, it has been ended."""
        step = self._step
        if (reason := self._supervision.reason_to_end()) is not None:
            self._end(reason)
        elif step + 1 == self._total:
            self._end(None)
        else:
            if self._command.step < step:
                self._missed.append(step)
            # also while this process was stopped
            if fault := self._watch.fault(self._clock.elapsed(), step, self._command.step):
                self._end(fault)
        return self._phase == "running"

    def _end(self, reason: str | None) -> None:
        """End a test: the rig comes to rest whatever the reason; None if all steps are done."""
        self._stop.begin(self._command.value)
        self._phase = FINISHED if reason is None else TRIPPED
        self._supervision.latched, self._supervision.wanted = True, None  # a test runs once
        self._rest.begin()
        self._comes_to_rest = True
        step = self._step
        trip = Trip(reason, step, self._timebase.stamp_ns(step) / 1e9) if reason else None
        self._report(self._phase, trip)

    def _follow_to_rest(self, sample: Floats) -> None:
        if not self._comes_to_rest:
            return
        status, values = self._status, {}
        if self._rest.is_reached(sample):
            values["stop time (s)"] = f"{self._rest.time:.4g}"
            values["stop peak force (N)"] = f"{self._rest.peak_force:.1f}"
        elif self._rest.time > self._section["safe.settle_time"]:
            text = f"{status.message}; not at rest after {self._rest.time:.3g} s"
            text += ", the pressure was dumped" if self._stop.has_dumped else ""
            status = replace(status, level=ERROR, message=text)
        else:
            return
        self._comes_to_rest = False
        self._shell.report(replace(status, values={**status.values, **values}))

    def _report(self, phase: str, trip: Trip | None = None) -> None:
        wall, missed = self._clock.monotonic() - self._started, self._missed
        outcome = Outcome(phase, self._step + 1, len(missed), missed, wall, trip, self._overruns)
        self._status = rig_status(outcome)
        self._shell.report(self._status)

    def _on_experiment_state(self, raw: bytes, at: int) -> None:
        """Follow the supervisor; a test that was not ready before does not move this rig."""
        supervision = self._supervision
        supervision.receive(raw, at)
        if self._phase == "running":
            return
        if supervision.state == "idle" and self._phase != "idle":
            self._phase, self._comes_to_rest = "idle", False  # how it ended has been reported
            supervision.latched = False
            self.report("idle")
        elif supervision.is_moving:
            try:
                ahead = until_start(supervision.wanted.values, self._clock.time_ns())
                self._start = self._clock.monotonic() + ahead
            except InputError as error:
                supervision.wanted = None
                raise WireError(str(error)) from None


def kind_of(make: Callable[[NodeShell], Hardware]) -> NodeKind:
    """Make the node of some hardware, for a process or a `seft_msgs_py.virtual.LocalGraph`."""
    return NodeKind(TABLE, [TABLE], lambda shell: DriverNode(shell, make(shell)))


def serve(make: Callable[[NodeShell], Hardware]) -> int:
    """Run the driver of some hardware; return the exit status."""
    return kind_of(make).main()


def stand_in(shell: NodeShell) -> StandIn:
    """Make the stand-in; put your own hardware here."""
    experiment, axes = shell.experiment, shell.rig.axes
    at = per_axis(experiment["rig"]["safe.valve_command"], axes, "rig: safe.valve_command")
    return StandIn(experiment.timebase.rate, axes, at)


KIND = kind_of(stand_in)


def main() -> int:
    """Entry point of ``ros2 run rig_driver rig``."""
    return KIND.main()


if __name__ == "__main__":
    sys.exit(main())
