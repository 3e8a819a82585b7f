"""The loop at the rate of a test before anything moves: how long it takes, and what it misses."""

import time
from collections.abc import Callable
from typing import Any

from seft_msgs_py.node.node_shell import NodeShell
from seft_msgs_py.wire.timebase import Timebase
from seft_msgs_py.wire.topics import RIG_STATE, LoopTopic, rehearsed
from seft_msgs_py.wire.trajectory import Floats, TrajectoryCodec

from seft_plant_sim.command import Command
from seft_plant_sim.rig_watch import RoundTrip, SampleClock

UNCOUNTED = 0.25  # of the steps: until then the host learns how busy the loop is
FIRST_ANSWER = 1.0  # s, longest wait for it
LATEST = 256  # steps: an answer that is older has no round trip


class Rehearsal:
    """The rig's side of it, on topics of its own, which no other node takes for a test.

    Parameters
    ----------
    shell : NodeShell
        Of the rig.
    timebase : Timebase
        Sampling clock.
    drive : LoopTopic
        Of the commands that the rig obeys.
    limit : float
        Of the commands, in their unit.
    """

    def __init__(
        self, shell: NodeShell, timebase: Timebase, drive: LoopTopic, limit: float
    ) -> None:
        self._shell, self._timebase = shell, timebase
        self._codec = TrajectoryCodec(RIG_STATE, shell.rig.axes, timebase)
        self._publish = shell.publisher(rehearsed(RIG_STATE))
        self._command = Command(TrajectoryCodec(drive, shell.rig.axes, timebase), limit)
        self._round_trip = RoundTrip()
        self._published_at = [0.0] * LATEST
        self._counts = False
        shell.subscribe(rehearsed(drive), self._take, reliable=False)

    def run(
        self, seconds: float, sample: Callable[[int], Floats], stop: Callable[[], bool]
    ) -> dict[str, Any]:
        """Publish samples at the rate, and count what is answered.

        Parameters
        ----------
        seconds : float
            For how long.
        sample : callable
            Gives the state of a step, shape (4, n), of a rig whose valve is at its safe value.
        stop : callable
            Whether to end early.

        Returns
        -------
        dict
            ``rate_hz``; ``steps`` that were counted, ``missed`` (those without a command at their
            end), ``overruns`` of the rig itself, and ``round_trip_s`` as of
            `seft_msgs_py.wire.outcome.ROUND_TRIPS`. JSON values.
        """
        shell, command, period = self._shell, self._command, self._timebase.dt
        steps = max(round(seconds / period), 8)
        first = round(UNCOUNTED * steps)
        command.reset()
        self._round_trip.reset()
        self._counts, missed, clock, before = False, 0, SampleClock(period, 0.0, makes_up=False), 0
        for step in range(steps):
            if step == first:
                self._counts, before = True, clock.overruns
            command.current = step
            raw = self._codec.encode(step, sample(step))
            self._published_at[step % LATEST] = time.monotonic()
            self._publish(raw)
            if step == 0:  # others prepare when they learn of it
                begun = time.monotonic()
                while command.step < 0 and time.monotonic() - begun < FIRST_ANSWER and not stop():
                    shell.spin_once(period)
                clock.fall_back(time.monotonic())
            while (left := clock.deadline(step + 1) - time.monotonic()) > 0:
                shell.spin_once(left)
            clock.awake(-left)
            late = time.monotonic() + period
            while command.step < step and time.monotonic() < late and shell.spin_once(0.0):
                pass  # as in a test: what arrived while we were late is in time
            missed += self._counts and command.step < step
            if stop():
                break
        return {
            "rate_hz": self._timebase.rate,
            "steps": max(step + 1 - first, 0),
            "missed": missed,
            "overruns": clock.overruns - before,
            "round_trip_s": self._round_trip.numbers(),
        }

    def _take(self, raw: bytes, _: int) -> None:
        now, command = time.monotonic(), self._command
        command.take(raw)
        if self._counts and command.current - command.answered < LATEST:
            self._round_trip.add(now - self._published_at[command.answered % LATEST])
