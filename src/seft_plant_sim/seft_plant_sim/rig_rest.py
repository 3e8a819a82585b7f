"""A rig between two tests: it comes to rest, its hardware may fail, the loop is rehearsed."""

from collections import deque
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.node.node_shell import IDLE_WAIT, NodeShell
from seft_msgs_py.wire.outcome import REHEARSED, ZEROED
from seft_msgs_py.wire.topics import RIG_STATE, Timebase, rehearsed
from seft_msgs_py.wire.trajectory import TrajectoryCodec

from seft_plant_sim import rig_watch
from seft_plant_sim.command import Command
from seft_plant_sim.hardware.hosted import HardwareError
from seft_plant_sim.hardware.safe_stop import Stopped
from seft_plant_sim.rig import Rig

SOON = 1.0  # s, for which a failure of the hardware counts; and between two that are told


class RigRest:
    """Keeps a rig at rest between two tests.

    Parameters
    ----------
    shell : NodeShell
        Of the rig.
    rig : Rig
        Its hardware is called.
    period : float
        Sampling period, s.
    is_sampled : bool
        Whether its samples go on.
    tell : callable
        Called with what is wrong with the hardware; with nothing when that is over.
    at_rest : callable
        Called with the end of a stop that went on after its test.

    Attributes
    ----------
    due : float
        Time of the next sample, s, monotonic.
    failure : str
        What is wrong with the hardware.
    """

    def __init__(
        self,
        shell: NodeShell,
        rig: Rig,
        period: float,
        *,
        is_sampled: bool,
        tell: Callable[[str], None],
        at_rest: Callable[[Stopped], None],
    ) -> None:
        self._shell, self._rig, self._period = shell, rig, period
        self._is_sampled, self._tell, self._at_rest = is_sampled, tell, at_rest
        self.due, self.failure = shell.clock.monotonic(), ""
        self._failed_at = self._told_at = 0.0

    def turn(self, longest: float = IDLE_WAIT) -> None:
        """Handle messages; take a sample that is due, or wait at most ``longest`` s."""
        if not (self._is_sampled or self._rig.hardware.is_stopping):
            self._shell.spin_once(longest)
            return
        now = self._shell.clock.monotonic
        while self._is_sampled and (left := self.due - now()) > 0:
            self._shell.spin_once(left)
        self._shell.spin_once(0.0)
        self.due = max(self.due + self._period, now())  # after a stall it goes on from here
        self.sample()

    def sample(self) -> None:
        """Take a sample, and continue a stop."""
        rig, hardware = self._rig, self._rig.hardware
        is_read = self.attempt(rig.read, is_safe=hardware.is_closing) is not None
        now = self._shell.clock.monotonic()
        if is_read and self.failure and now - self._failed_at >= SOON:
            self.failure = ""
            self._tell("")
        if hardware.is_clock:  # a stop takes each sample at once
            self.due = now + (not hardware.is_stopping) * (1 - rig_watch.EARLY) * self._period
        stopped = self.attempt(partial(rig.come_to_rest, is_read=is_read))
        if stopped is not None:
            self._at_rest(stopped)

    def attempt(self, call: Callable[[], Any], *, is_safe: bool = False) -> Any:
        """Call the hardware; at a fault it goes to its safe command.

        Unless it ``is_safe`` to do nothing. The result is None then.
        """
        try:
            return call()
        except HardwareError as error:
            self._failed_at = now = self._shell.clock.monotonic()
            if not self.failure or (self.failure != str(error) and now - self._told_at >= SOON):
                self.failure, self._told_at = str(error), now
                self._shell.log("error", self.failure)
                self._tell(self.failure)
            with suppress(HardwareError):
                if not is_safe:
                    self._rig.hardware.safe()
        return None


ALONE = 0.25  # of the steps: each one after the answer to the one before, and the host adapts
FIRST_ANSWER = 5.0  # s, longest wait: the nodes make blocks for the rehearsal
LATER_ANSWER = 0.1  # s, longest wait: a message may be lost, which ends the steps alone


class Rehearsal:
    """The rig's part of a rehearsal, on separate topics, so that no node takes it for a test.

    Parameters
    ----------
    shell : NodeShell
        Of the rig.
    timebase : Timebase
        Sampling clock.
    drive : Command
        That the rig obeys in a test.
    rig : Rig
        Without faults; its valve stays at the safe command.
    is_sampled : bool
        Whether it rests there already, and is sampled between two tests.
    """

    def __init__(
        self, shell: NodeShell, timebase: Timebase, drive: Command, rig: Rig, is_sampled: bool
    ) -> None:
        self._shell, self._timebase = shell, timebase
        self._rig, self._is_sampled = rig, is_sampled
        self._codec = TrajectoryCodec(RIG_STATE, shell.rig.axes, timebase)
        self._publish = shell.publisher(rehearsed(RIG_STATE))
        self._command = Command(drive.codec, drive.limit)
        self._alone, self._round_trip = rig_watch.RoundTrip(), rig_watch.RoundTrip()
        self._times = self._alone
        shell.subscribe(rehearsed(drive.codec.topic), self._take, reliable=False)

    def run(self, seconds: float, zeroing: int, stop: Callable[[], bool]) -> dict[str, Any]:
        """Publish samples, the first ones when the loop has answered, the others at the rate.

        So the first ones show how fast the loop can be: at a rate that is too high answers queue.

        Parameters
        ----------
        seconds : float
            Duration, s.
        zeroing : int
            Number of last samples from which biases are taken that nobody knows.
        stop : callable
            Says whether to end early, without facts.

        Returns
        -------
        dict
            Facts about the rig (JSON values): what it measured at rest, if it did; and of the
            rehearsal ``rate_hz``, the ``steps`` at the rate, ``missed`` (steps without a command
            at their end), ``overruns`` of the rig itself, ``round_trip_s``, see
            `seft_msgs_py.wire.outcome.ROUND_TRIPS`, and ``round_trip_alone_s`` of the first steps.
        """
        shell, command, period = self._shell, self._command, self._timebase.dt
        steps = max(round(seconds / period), 8)
        first, longest = round(ALONE * steps), FIRST_ANSWER  # other nodes prepare at step 0
        rig, resting = self._rig, deque[Floats](maxlen=zeroing)
        rig.begin()
        command.reset()
        self._times, missed = self._alone, 0
        clock = rig_watch.SampleClock(period, 0.0, makes_up=False)
        for times in (self._alone, self._round_trip):
            times.reset()
        for step in range(steps):
            command.current = step
            if step and not self._is_sampled:
                rig.write(rig.safe_command)
            raw = self._codec.encode(step, rig.read())
            resting.append(rig.raw)
            now = shell.clock.monotonic()
            if step == first:
                self._times = self._round_trip
                clock.fall_back(now - clock.deadline(step))
            if rig.hardware.is_clock:
                clock.follow(step, now)
            self._times.published(step, now)
            self._publish(raw)
            if step < first:
                rig_watch.wait_for_command(shell, command, step, longest, stop)
                first, longest = first if command.step == step else step + 1, LATER_ANSWER
            else:
                rig_watch.wait_for_sample(shell, command, step, clock, lambda: None)
                missed += command.step < step
            if stop():
                return {}
        facts: dict[str, Any] = {}
        if self._is_sampled and zeroing:
            rig.zero(np.array(resting))
            facts[ZEROED] = rig.zeroed
        rig.begin()
        facts[REHEARSED] = {
            "rate_hz": self._timebase.rate,
            "steps": max(steps - first, 0),
            "missed": missed,
            "overruns": clock.overruns,
            "round_trip_s": self._round_trip.numbers(),
            "round_trip_alone_s": self._alone.numbers(),
        }
        return facts

    def _take(self, raw: bytes, _: int) -> None:
        now = self._shell.clock.monotonic()
        self._command.take(raw)
        self._times.answered(self._command, now)
