"""State of the test and its nodes, from their messages, for the page."""

import math
import time
from collections import deque
from collections.abc import Callable
from itertools import chain
from typing import Any

from seft_msgs_py.node.transport import AwakeClock
from seft_msgs_py.wire.experiment_state import ExperimentState
from seft_msgs_py.wire.messages import Status
from seft_msgs_py.wire.outcome import ENDED, RIG, State
from seft_msgs_py.wire.topics import NODES, bare

from seft_ros.ground_motion.record_file import source_name

SILENCE_PERIOD = 1.0  # s; nodes give a sign of life five times a second
ENDED_WITH_TEST = 0.5  # s before a test's end: a node that sent then was shut down after it
NOT_BEGUN = (State.IDLE, State.READY)
EVENTS = 200
_MARGIN, ROUND_TRIP = "margin ", "round trip "


class Session:
    """Follows states, diagnostics and descriptions of successive tests.

    Parameters
    ----------
    wall : callable, optional
        Wall-clock time, s, for the list of events.
    awake : AwakeClock, optional
        Clock for the silence of nodes.

    Attributes
    ----------
    sections : dict
        Node -> its parameters.
    round_trips : list
        Of the running test, by the rig: (test time in s, median, largest in ms, missed).
    events : deque
        The newest events, oldest first: time (s), event, reason, and level.
    number : int
        Counts the states; a request of another state is not carried out.
    """

    def __init__(
        self, wall: Callable[[], float] = time.time, awake: AwakeClock | None = None
    ) -> None:
        self._wall, self._awake = wall, awake or AwakeClock()
        self._now = self._awake.time()
        self.sections: dict[str, dict[str, Any]] = {}
        self.round_trips: list[tuple[float, float | None, float | None, float]] = []
        self._experiment: ExperimentState | None = None  # no message yet
        self._heard_at, self._silent = 0.0, False
        self.number = 0
        self._ended_at = 0.0
        self._nodes: dict[str, tuple[Status, float]] = {}
        self._rigs: dict[str, dict[str, float]] = {}  # rig -> its numbers
        self.events: deque[dict[str, Any]] = deque(maxlen=EVENTS)

    def poll(self) -> None:
        """Read the clock; a supervisor that has become silent is an event."""
        self._now = self._awake.time()
        silent = self._experiment is not None and self._now - self._heard_at > SILENCE_PERIOD
        if silent and not self._silent and self._state in ENDED:
            self._note("left", "the nodes of the test have shut down", 4)
        elif silent and not self._silent:
            self._note("gone", "the supervisor is silent", 3)
        self._silent = silent

    def on_state(self, test: ExperimentState) -> bool:
        """Process experiment/state; return whether a new test begins."""
        before, last = self._state, self._experiment
        self._experiment, self._heard_at = test, self._now
        is_new = last is None or (last.state, last.detail) != (test.state, test.detail)
        if self._silent or is_new:
            self._note(test.state, test.detail, test.level)
        self._silent = False
        if test.state == before:
            return False
        self.number += 1
        if test.state in ENDED:
            self._ended_at = self._now
        begins = test.state in (*NOT_BEGUN, State.RUNNING)
        return begins and before in (*ENDED, State.RUNNING, State.RAMPING_DOWN)

    def begin(self) -> None:
        """Forget the last test's round trips and margins."""
        self.round_trips = []
        self._rigs = {}

    def on_diagnostics(self, statuses: list[Status], dt: float) -> None:
        """Process the diagnostics of nodes; dt is the period of a step, s."""
        for status in statuses:
            if bare(status.name) not in NODES:
                continue
            self._nodes[status.name] = (status, self._now)
            is_rig = bare(status.name) == RIG and status.values.get("phase", "idle") != "idle"
            if is_rig and self._state not in NOT_BEGUN:  # else it is the last test's
                self._follow_rig(status, dt)

    def on_description(self, node: str, parameters: dict[str, Any]) -> None:
        """Process a node's parameters; several rigs share theirs."""
        self.sections[bare(node)] = parameters

    def summary(self) -> dict[str, Any]:
        """Give the values for the page, JSON values."""
        test, rig = self._experiment, self._of_all_rigs()
        return {
            "heard": test is not None,
            "number": self.number,
            "name": self._name(),
            "silent": self._silent,
            "state": self._state,
            "detail": test.detail if test else "",
            "step": test and test.step,
            "time_s": test and test.time_s,
            "steps": test and test.steps,
            "ended": self._state in ENDED,
            "missed": rig.get("missed"),
            "overruns": rig.get("overruns"),
            "margins": _of(rig, _MARGIN),
            "round_trip": _of(rig, ROUND_TRIP),
            "nodes": [self._node(name) for name in sorted(self._nodes, key=_order)],
        }

    @property
    def _state(self) -> str:
        return self._experiment.state if self._experiment else ""

    def _node(self, name: str) -> dict[str, Any]:
        status, at = self._nodes[name]
        silent = self._now - at > SILENCE_PERIOD
        ended = self._state in ENDED and at > self._ended_at - ENDED_WITH_TEST
        return {
            "name": name,
            "level": (4 if ended else 3) if silent else status.level,
            "text": status.message,
            "refused": status.number("refused"),
        }

    def _name(self) -> str:
        """Name the test in a few words."""
        motion, force = (self.sections.get(n, {}) for n in ("ground_motion", "reference_force"))
        if not motion and not force:
            return ""
        words = [source_name(motion.get("file") or "") or "synthetic motion"]
        if "mass_ratio" in force:
            words.append(f"mass ratio {force['mass_ratio']}")
        if method := force.get("compensation.method"):
            words.append(str(method) if method != "none" else "uncompensated")
        if bag := self.sections.get("recorder", {}).get("name"):
            words.append(f"bag {bag}")
        return ", ".join(words)

    def _of_all_rigs(self) -> dict[str, float]:
        """Combine the numbers of all rigs: the sum of missed commands, otherwise the worst."""
        rigs, found = self._rigs.values(), {}
        for name in dict.fromkeys(chain(*rigs)):
            values = [rig[name] for rig in rigs if name in rig]
            worst = min(values) if name.startswith(_MARGIN) else max(values)
            found[name] = sum(values) if name in ("missed", "overruns") else worst
        return found

    def _follow_rig(self, status: Status, dt: float) -> None:
        before = self._rigs.get(status.name, {})
        numbers = {name: _number(text) for name, text in status.values.items()}
        self._rigs[status.name] = own = {n: v for n, v in numbers.items() if v is not None}
        if status.name != next(iter(self._rigs)):
            return  # round trips of the first rig are shown
        steps, last = own.get("steps", 0.0), before.get("steps", 0.0)
        if steps < last:
            self.round_trips = []  # those of another test
        if steps == last:
            return
        trip = _of(own, ROUND_TRIP)
        times = trip.get("median (ms)"), trip.get("largest (ms)")
        self.round_trips.append((steps * dt, *times, own.get("missed", 0.0)))
        if len(self.round_trips) > 2 * EVENTS:
            del self.round_trips[1::2]  # every second one: memory is bounded

    def _note(self, what: str, detail: str, level: int) -> None:
        at = round(self._wall(), 3)
        self.events.append({"at": at, "what": what, "detail": detail, "level": level})


def _order(node: str) -> tuple[int, str]:
    return (NODES.index(bare(node)), node)


def _of(numbers: dict[str, float], start: str) -> dict[str, float]:
    return {n.removeprefix(start): value for n, value in numbers.items() if n.startswith(start)}


def _number(text: str | None) -> float | None:
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if math.isfinite(value) else None
