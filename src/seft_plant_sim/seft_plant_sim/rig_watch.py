"""Watches of a rig node: time, commands, recorder, supervisor, round trips; and its report."""

import math
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from seft_msgs_py.errors import WireError
from seft_msgs_py.node.node_shell import NodeShell
from seft_msgs_py.node.transport import AwakeClock, Clock
from seft_msgs_py.wire import outcome
from seft_msgs_py.wire.experiment_state import ExperimentState, decode_state
from seft_msgs_py.wire.messages import ERROR, WARN, Status, decode_diagnostics
from seft_msgs_py.wire.outcome import Outcome, rig_status
from seft_msgs_py.wire.topics import LoopTopic

from seft_plant_sim.command import Command
from seft_plant_sim.hardware.safe_stop import Stopped
from seft_plant_sim.rig import Rig


class CommandWatch:
    """Checks at the end of each period whether the rig may continue with its present command.

    While the rig's process or its host stalls, the valve stays open, and the newest command answers
    an old sample. So the watch uses time, not steps. Times are those of `Clock.elapsed`.

    Parameters
    ----------
    topic : LoopTopic
        Of the commands.
    period : float
        Of the samples, s.
    timeout : float
        Longest time without a new command, s; a period at least.

    Attributes
    ----------
    waited : float
        The timeout, if commands are missing and the rig has not stood still; else 0, s.
    """

    def __init__(self, topic: LoopTopic, period: float, timeout: float) -> None:
        self._topic, self._period, self._timeout = topic, period, timeout
        self.begin(0.0)

    def begin(self, now: float) -> None:
        """Begin with the first sample of a test."""
        self._answered, self._fresh_at, self.waited = -1, now, 0.0

    def fault(
        self, now: float, step: int, answered: int, *, in_vain: bool = False, reading: float = 0.0
    ) -> str:
        """Say why the test must end here, before a command is applied; empty if it may continue.

        Parameters
        ----------
        now : float
            Time, s.
        step : int
            Step of the last sample.
        answered : int
            Last step whose command is known; -1: none.
        in_vain : bool
            Whether the rig has delayed its next sample and waited for as long as it may.
        reading : float
            Time that the last sample's reading took, s.
        """
        period, timeout = self._period, self._timeout
        behind = step - answered
        is_new = answered > self._answered or behind <= 0
        without = now - self._fresh_at - is_new * period
        if is_new:
            self._answered, self._fresh_at = answered, now - max(behind, 0) * period
        if without <= max(timeout, period) + period / 2 and not in_vain:
            return ""
        name = self._topic.name
        if behind * period <= min(timeout, without / 2) and not in_vain:
            if reading > without / 2:
                return f"the rig's hardware gave no sample for {reading:.3g} s"
            why = "its process or its host was stopped or overloaded"
            most = f"({timeout:g} s without a new {name} are allowed)"
            return f"the rig stood still for {without:.3g} s, and its valve with it: {why} {most}"
        self.waited = timeout
        last = f"(the last is of step {answered})"
        return f"no new {name} for {timeout:g} s {last}; is {self._topic.publisher} running?"


EARLY = 0.25
"""Of a period: so long before the next sample of a controller that is the clock, its command goes
out where the answer has not come. This host's wake and the datagram take that time."""
OVERRUN = 0.5  # of a period: after it what remains of the period is too short for an answer
_HURRY = 0.05  # of a period, by which steps are shorter while a rig makes up for lost time
POLL = 0.002  # s, longest wait until it is asked again whether to stop


class SampleClock:
    """Absolute deadlines, one for each period.

    After an overrun, a deadline missed by more than half a period, all deadlines are shifted:
    shorter steps would leave the others no time to answer. A rig that makes up for lost time
    returns to its schedule by slightly shorter steps. Times are in s, monotonic.
    """

    def __init__(self, period: float, start: float, *, makes_up: bool) -> None:
        self.period, self._makes_up = period, makes_up
        self._start = self._on_time = start
        self.overruns = 0

    def deadline(self, step: int) -> float:
        """Time of a step, s, monotonic."""
        return self._start + step * self.period

    def awake(self, late: float) -> None:
        """Process the time in s by which a deadline was missed."""
        if late > OVERRUN * self.period:
            self.overruns += 1
            self.fall_back(late)
        if self._makes_up and self._start > self._on_time:
            self._start -= min(_HURRY * self.period, self._start - self._on_time)

    def follow(self, step: int, now: float) -> None:
        """Take a step's time from a controller that is the clock, and be early for the next."""
        self._start = self._on_time = now - (step + EARLY) * self.period

    def fall_back(self, time: float) -> None:
        """Shift all later deadlines by a time in s."""
        self._start += time


def wait_for_command(
    shell: NodeShell, command: Command, step: int, longest: float, stop: Callable[[], object]
) -> float:
    """Wait at most ``longest`` s for the command of a step, or until ``stop``; give the time, s."""
    now = shell.clock.monotonic
    begun = now()
    while command.step < step and (left := begun + longest - now()) > 0.0 and not stop():
        shell.spin_once(min(POLL, left))
    return now() - begun


def wait_for_sample(
    shell: NodeShell, command: Command, step: int, clock: SampleClock, answered: Callable[[], None]
) -> None:
    """Wait until the sample after a step is due; ``answered`` is called if there is time left."""
    now = shell.clock.monotonic
    while (left := clock.deadline(step + 1) - now()) > 0:
        if shell.spin_once(left) and command.step >= step:
            answered()
    clock.awake(-left)
    late = now() + clock.period
    while command.step < step and now() < late and shell.spin_once(0.0):
        pass  # messages that arrived during a stall are in time; a flood must not block


MAX_UNRECORDED_STEPS = 3072
"""Steps: three quarters of a queue's length. The recorder reports its step five times a second."""


class RecorderLag:
    """Follows the recorder's status.

    Parameters
    ----------
    patience : float
        Silence after which the rig no longer waits for it, s: the supervisor decides whether a test
        continues without a recorder.
    """

    def __init__(self, patience: float, clock: Clock) -> None:
        self._patience, self._awake = patience, AwakeClock(clock.monotonic)
        self._received_at = -patience
        self._recorded = 0

    def receive(self, raw: bytes, _: int) -> None:
        """Process the diagnostics of a node."""
        for status in decode_diagnostics(raw)[1]:
            if status.name == outcome.RECORDER_NODE_NAME:
                self._received_at = self._awake.time()
                self._recorded = int(status.number(outcome.RECORDED) or 0)

    def reset(self) -> None:
        """Begin a test."""
        self._recorded = 0

    def is_large(self, step: int) -> bool:
        """Say whether the rig should wait after a step until more is recorded."""
        if step - self._recorded < MAX_UNRECORDED_STEPS:
            return False
        return self._awake.time() - self._received_at < self._patience


class Supervision:
    """The supervisor's requests to this rig, which does not move without a supervisor.

    Parameters
    ----------
    patience : float
        Silence of the supervisor after which a test must end, s.

    Attributes
    ----------
    wanted : ExperimentState or None
        State of the experiment that the rig follows; None while it stays at rest.
    state : str
        Last published state.
    fault : str
        Fault of the program, which ends every test until the supervisor publishes idle.
    latched : bool
        Whether a test tripped: no new one begins before the supervisor publishes idle.
    rehearsal : float
        Requested duration of a rehearsal, s; 0: none.
    zeroing : float
        Time in it in which the rig measures its biases, s; 0: none.
    """

    def __init__(self, patience: float, clock: Clock) -> None:
        self._patience, self._awake = patience, AwakeClock(clock.monotonic)
        self._received_at = self._awake.time()
        self.wanted: ExperimentState | None = None
        self.state = self.fault = ""
        self.latched = self._armed = False
        self.rehearsal = self.zeroing = 0.0

    @property
    def is_moving(self) -> bool:
        """Whether the rig should move."""
        return self.wanted is not None and self.wanted.state in outcome.MOVING

    def receive(self, raw: bytes, _: int) -> None:
        """Follow the supervisor; a rig that starts in the middle of a test stays at rest."""
        test = decode_state(raw)
        self._received_at = self._awake.time()
        self.rehearsal, self.zeroing = test.rehearse, test.zeroing
        if test.state == self.state:
            return  # a sign of life
        self.state = test.state
        if test.state in outcome.MOVING and not (self._armed or self.is_moving):
            why = "that began before this rig was ready"
            raise WireError("a test " + ("after a trip and no reset" if self.latched else why))
        if test.state == "running" and not test.steps:
            raise WireError("a test without its number of steps")
        if test.state == "idle":
            self.latched, self.fault = False, ""
        self._armed = test.state == "ready" and not self.latched
        self.wanted = test

    def reason_to_end(self) -> str | None:
        """Give the reason why a test must end here, if there is one."""
        if self.fault:
            return self.fault
        if not self.is_moving:
            return outcome.STOPPED
        if self._awake.time() - self._received_at > self._patience:
            return f"node supervisor has been silent for {self._patience:g} s"
        return None


SHORTEST = 1e-5  # s, lower edge of the first bin
PER_DECADE = 20  # bins: the error of a median is at most 6 %
DECADES = 7
_QUANTILES = {"p50": 0.5, "p90": 0.9, "p99": 0.99, "p99.9": 0.999}
EDGES = [SHORTEST * 10 ** (at / PER_DECADE) for at in range(1, PER_DECADE * DECADES)]


_LATEST = 256  # steps: an answer that is older has no round trip


class RoundTrip:
    """Times from a state to its command: histogram with bins of equal ratio, last, largest.

    Attributes
    ----------
    last : float
        The last time, s; nan if there was none.
    """

    def __init__(self) -> None:
        self._published_at = [0.0] * _LATEST  # the last states, by step
        self.reset()

    def reset(self) -> None:
        """Forget the test so far."""
        self._bins = [0] * (PER_DECADE * DECADES)
        self.last, self._largest = math.nan, -math.inf

    def published(self, step: int, at: float) -> None:
        """Note the time at which a state is published, s."""
        self._published_at[step % _LATEST] = at

    def answered(self, command: Command, at: float) -> None:
        """Count the newest command, which arrived at a time in s, unless its state is too old."""
        if command.current - command.answered < _LATEST:
            self.add(at - self._published_at[command.answered % _LATEST])

    def add(self, time: float) -> None:
        """Count a time in seconds."""
        self._bins[bisect_right(EDGES, time)] += 1
        self.last, self._largest = time, max(self._largest, time)

    def numbers(self) -> dict[str, float]:
        """Give quantiles and the largest, s, by the keys of `ROUND_TRIPS`; empty without a time.

        A quantile is the middle of its bin, and at most the largest time.
        """
        if math.isnan(self.last):
            return {}
        seen = np.cumsum(self._bins)
        bins = np.searchsorted(seen, [share * seen[-1] for share in _QUANTILES.values()])
        middles = np.minimum(SHORTEST * 10 ** ((bins + 0.5) / PER_DECADE), self._largest)
        return {**dict(zip(_QUANTILES, middles.tolist(), strict=True)), "largest": self._largest}


NARROW = 0.1  # of a limit: a smaller margin gives a warning


def rig_report(
    result: Outcome,
    rig: Rig,
    compute: RoundTrip,
    round_trip: RoundTrip,
    age: float,
    stopped: Stopped | None,
) -> Status:
    """Make the status of a test, with names for diagnostic tools.

    Parameters
    ----------
    result : Outcome
        So far.
    rig : Rig
        With its last sample.
    compute, round_trip : RoundTrip
        Times from a sample's reading to its state, and from a state to its command.
    age : float
        Of the newest command, s; nan: none.
    stopped : Stopped or None
        How the rig came to rest, if it has.
    """
    status = rig_status(result)
    values, level = dict(status.values), status.level
    message = result.phase if result.phase == "running" else status.message
    name, share = rig.guard.nearest
    values["nearest detector"] = f"{name}: {share:.2f} of its threshold"
    for what, time in compute.numbers().items():
        values[f"compute {what} (ms)"] = f"{time * 1e3:.3f}"
    values |= {f"datagrams {kind}": str(count) for kind, count in rig.hardware.counts.items()}
    margins = {limit.replace("_", " "): left for limit, left in rig.guard.limits.margins().items()}
    values |= {f"margin {limit}": f"{left:.3f}" for limit, left in margins.items()}
    if not math.isnan(age):
        values["command age (ms)"] = f"{age * 1e3:.2f}"
    if not math.isnan(round_trip.last):
        values["round trip last (ms)"] = f"{round_trip.last * 1e3:.3f}"
    if stopped is None and result.phase in (outcome.FINISHED, outcome.TRIPPED):
        values[outcome.STOPPING] = "until its valve is closed and it rests"
    elif stopped is not None:
        values["stop peak force (N)"] = f"{stopped.peak_force:.1f}"
        values["stop time (s)"] = f"{stopped.time:g}"
        if not stopped.is_at_rest:
            dumped = ", the pressure was dumped" if stopped.has_dumped else ""
            level, values[outcome.NOT_AT_REST] = ERROR, f"{stopped.time:.3g} s{dumped}"
            message += f"; not at rest after {values[outcome.NOT_AT_REST]}"
    narrow = [limit for limit, left in margins.items() if not left >= NARROW]
    if narrow and level < WARN:
        level = WARN
        message += f"; less than {NARROW * 100:.0f} % left to the limit of {', '.join(narrow)}"
    return replace(status, level=level, message=message, values=values)
