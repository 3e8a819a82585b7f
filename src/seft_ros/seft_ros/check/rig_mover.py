"""Moves the hardware of a rig at its rate, in this process and thread, and brings it to rest."""

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.node.process import as_before, on_ending
from seft_msgs_py.node.transport import Clock
from seft_msgs_py.wire.topics import RigAxes
from seft_plant_sim.hardware.hosted import HardwareError, HostedHardware
from seft_plant_sim.rig import Rig
from seft_plant_sim.rig_parameters import SIMULATED
from seft_plant_sim.rig_watch import SampleClock

LEAD = 0.3  # s of rest before each motion


class RigMover:
    """Moves a rig whose sensors are not trusted yet.

    A limit of the experiment ends a motion. So does a far smaller one, ``travel`` (m) from where it
    rested and ``force`` (N), if two of displacement, integrated velocity and force are beyond it:
    a single wrong sensor is to be found by the motion. Detectors, which trust sensors, only warn.

    Attributes
    ----------
    rig, hosted, dt, n
        One rig of an experiment; its hardware, if not simulated; sampling period, s; its axes.
    fault, raw
        Why the last motion had to end, or empty; its samples as read, shape (N, 4, n).
    times, late
        Times that each read() and write() has taken, s; number of samples that came too late.
    """

    def __init__(
        self, experiment: Experiment, of: RigAxes, clock: Clock, travel: float, force: float
    ) -> None:
        section, axes, timebase = experiment["rig"], experiment.axes, experiment.timebase
        section = {**section, "detectors.warn_only": "all"}
        self.hosted: HostedHardware | None = None
        if section["hardware"] != SIMULATED:  # a call may take long here: it is looked at
            self.hosted = HostedHardware(section, axes, of, np.inf, clock.monotonic)
        self.rig = Rig(section, axes, timebase, of, self.hosted)
        self.dt, self.n, self._clock = timebase.dt, len(of.axes), clock
        self._travel, self._force, self.fault = travel, force, ""
        self.times: list[tuple[float, float]] = []
        self.late = 0

    def step_at(self, time: float) -> int:
        """Step of a time, s."""
        return round(time / self.dt)

    def play(self, commands: Floats, safe_at: int | None = None) -> Floats:
        """Give commands, V or N, shape (N, n), 0 in the first `LEAD` s, one after each sample.

        They add to the safe command, so 0 is rest.
        From a step on, ``safe`` stands in their place. Gives the samples, calibrated and aligned,
        shape (m, 4, n): m is less than N where the motion had to end; then the rig was stopped. If
        its hardware fails, it raises a HardwareError.
        """
        self._begin()
        rig, now, safe = self.rig, self._clock.monotonic, self.rig.safe_command
        rig.begin()
        samples = np.empty((len(commands), 4, self.n))
        self.raw, self.fault = np.empty_like(samples), ""
        for step, command in enumerate(commands):
            begun = now()
            rig.read()
            took = now() - begun
            samples[step], self.raw[step] = rig.measured, rig.raw
            self.fault = rig.violation or self._too_far(step, samples)
            if self.fault:
                self.come_to_rest()
                return samples[: step + 1]
            self._wait()
            begun = now()
            if safe_at is None or step < safe_at:
                rig.write(safe + command)
            elif step == safe_at:
                self.hosted.safe() if self.hosted else rig.write(safe)
            self.times.append((took, now() - begun))
        rig.write(safe)
        self.late += self._samples.overruns
        return samples

    def come_to_rest(self) -> str:
        """Bring the rig to rest as a test does; say whether it is. Signals to end must wait."""
        before, why = on_ending(lambda *_: None), ""
        try:
            for _ in range(3):  # its hardware may fail meanwhile
                try:
                    return self._stopped()
                except HardwareError as error:
                    why = str(error)
                    self.rig.hardware.safe()
            return f"the rig is NOT known to be at rest: safe() was called, but {why}"
        except HardwareError as error:
            return f"the rig is NOT at rest: {error}"
        finally:
            as_before(before)

    def close(self) -> str:
        """Bring the rig to rest, and give its devices back; say whether it is."""
        text = self.come_to_rest()
        try:
            self.rig.hardware.close()
        except HardwareError as error:
            text += f"; {error}"
        return text

    def _stopped(self) -> str:
        self._begin()
        stopped = self.rig.stop()
        while stopped is None:
            self._wait()
            self.rig.read()
            stopped = self.rig.come_to_rest()
        if stopped.is_at_rest:
            return "the rig is at rest"
        speed, took = float(np.abs(self.rig.measured[1]).max()), stopped.time
        return f"the rig is NOT at rest: it shows {speed:.3g} m/s {took:.3g} s after the stop began"

    def _begin(self) -> None:
        self._samples, self._step = SampleClock(self.dt, self._clock.monotonic(), makes_up=False), 0

    def _wait(self) -> None:
        """Wait for the deadline of the next sample."""
        now, samples = self._clock.monotonic, self._samples
        if self.rig.hardware.is_clock:
            samples.follow(self._step, now())
        self._step += 1
        if (left := samples.deadline(self._step) - now()) > 0:
            self._clock.sleep(left)
        samples.awake(now() - samples.deadline(self._step))

    def _too_far(self, step: int, samples: Floats) -> str:
        """Say why a motion must end at a step; empty if it need not."""
        if step <= self.step_at(LEAD):
            self._rest, self._way = samples[: step + 1].mean(axis=0), np.zeros(self.n)
            return ""
        change = samples[step] - self._rest
        self._way = self._way + change[1] * self.dt
        moved, way, pushed = (float(np.abs(e).max()) for e in (change[0], self._way, change[3]))
        if sum((moved > self._travel, way > self._travel, pushed > self._force)) < 2:
            return ""
        text = f"moved {moved:.3g} m, {way:.3g} m by its velocity, force changed {pushed:.4g} N"
        return f"{text}: more than {self._travel:g} m and {self._force:g} N"
