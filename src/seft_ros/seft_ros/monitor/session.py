"""What the nodes of a graph say of themselves and of the test, as the page shows it."""

import time
from collections import deque
from collections.abc import Callable
from typing import Any

from seft_msgs_py.node.awake_clock import AwakeClock
from seft_msgs_py.wire.messages import Status
from seft_msgs_py.wire.outcome import RIG
from seft_msgs_py.wire.rigs import bare
from seft_msgs_py.wire.topics import NODES

from seft_ros.experiment.state_machine import ENDED, State

SILENCE = 1.5  # s; nodes give a sign of life five times a second
EVENTS = 200
MARGIN, ROUND_TRIP = "margin ", "round trip "
SHOWN = {
    "ground_motion": ("file", "peak_force", "time_scale"),
    "reference_force": ("method", "mass_ratio", "compensation.method", "loop_delay"),
    "rig": ("pace",),
}
"""Parameters that tell which test it is."""


class Session:
    """Follows states, diagnostics and descriptions of one test after another.

    Parameters
    ----------
    wall : callable, optional
        Wall-clock time, s, for the list of events.
    awake : AwakeClock, optional
        Tells how long others have been silent.

    Attributes
    ----------
    state : str
        Of the test; empty while nobody tells.
    sections : dict
        Node -> its parameters.
    round_trips : list
        Of the running test, by the rig: (test time in s, median, largest in ms, missed).
    """

    def __init__(
        self, wall: Callable[[], float] = time.time, awake: AwakeClock | None = None
    ) -> None:
        self._wall, self._awake = wall, awake or AwakeClock()
        self._now = self._awake.time()
        self.state = ""
        self.sections: dict[str, dict[str, Any]] = {}
        self.round_trips: list[tuple[float, float | None, float | None, int]] = []
        self._experiment: Status | None = None
        self._silent = False
        self._last = ("", "")
        self._nodes: dict[str, tuple[Status, float]] = {}
        self._rigs: dict[str, dict[str, str]] = {}
        self._events: deque[dict[str, Any]] = deque(maxlen=EVENTS)

    def look(self) -> None:
        """Note the time; a supervisor that has fallen silent is an event."""
        self._now = self._awake.time()
        heard = self._nodes.get("")
        silent = heard is not None and self._now - heard[1] > SILENCE
        if silent and not self._silent:
            self._note("gone", "nothing is heard of the supervisor any more", 3)
        self._silent = silent

    def on_state(self, status: Status) -> bool:
        """Take in experiment/state; tell whether a test begins with it."""
        before, self._experiment = self._experiment, status
        self._nodes[""] = (status, self._now)
        self.state = status.message
        news = (status.message, status.values.get("detail", ""))
        if before is None or self._silent or self._last != news:
            self._note(*news, status.level)
        self._last = news
        self._silent = False
        return status.message == State.RUNNING and (
            before is None or before.message != State.RUNNING
        )

    def begin(self) -> None:
        """Forget the last test's round trips and margins."""
        self.round_trips = []
        self._rigs = {}

    def on_diagnostics(self, statuses: list[Status], dt: float) -> None:
        """Take in what nodes say of themselves; dt is the period of a step, s."""
        for status in statuses:
            if bare(status.name) not in NODES:
                continue
            self._nodes[status.name] = (status, self._now)
            if bare(status.name) == RIG and status.values.get("phase", "idle") != "idle":
                self._follow_rig(status, dt)

    def on_description(self, node: str, parameters: dict[str, Any]) -> None:
        """Take in a node's parameters; those of several rigs are of all."""
        self.sections[bare(node)] = parameters

    def told(self) -> dict[str, Any]:
        """Make what the page shows of it, JSON values."""
        experiment = self._experiment
        values = experiment.values if experiment else {}
        rig = self._of_all_rigs()
        return {
            "heard": experiment is not None,
            "silent": self._silent,
            "state": self.state,
            "detail": values.get("detail", ""),
            "step": _whole(values.get("step")),
            "time_s": _number(values.get("time_s")),
            "steps": _whole(values.get("steps")),
            "ended": self.state in ENDED,
            "missed": _whole(rig.get("missed")),
            "overruns": _whole(rig.get("overruns")),
            "margins": _named(rig, MARGIN),
            "round_trip": _named(rig, ROUND_TRIP),
            "nodes": [self._node(name) for name in sorted(self._nodes, key=_order) if name],
            "parameters": self._parameters(),
        }

    def events(self) -> list[dict[str, Any]]:
        """Give what happened, oldest first: when (s), what, why, and its level."""
        return list(self._events)

    def _node(self, name: str) -> dict[str, Any]:
        status, at = self._nodes[name]
        silent = self._now - at > SILENCE
        return {
            "name": name,
            "level": 3 if silent else status.level,
            "text": status.message,
            "refused": _whole(status.values.get("refused")),
        }

    def _parameters(self) -> dict[str, str]:
        return {
            f"{node}: {name}": str(self.sections[node][name])
            for node, names in SHOWN.items()
            for name in names
            if self.sections.get(node, {}).get(name) not in (None, "", 0)
        }

    def _of_all_rigs(self) -> dict[str, str]:
        """Put together what rigs tell: what they miss added up, else the worst of each."""
        told = list(self._rigs.values())
        if len(told) < 2:
            return told[0] if told else {}
        found = dict(told[0])
        for other in told[1:]:
            for name, text in other.items():
                ours, theirs = _number(found.get(name)), _number(text)
                if ours is None or theirs is None:
                    continue
                if name in ("missed", "overruns"):
                    found[name] = str(round(ours + theirs))
                elif name.startswith((MARGIN, ROUND_TRIP)):
                    worst = min if name.startswith(MARGIN) else max
                    found[name] = str(worst(ours, theirs))
        return found

    def _follow_rig(self, status: Status, dt: float) -> None:
        before, values = self._rigs.get(status.name, {}), status.values
        if values == before:
            return
        is_first = next(iter(self._rigs), status.name) == status.name
        fresh = _whole(values.get("steps")) or 0
        told = _whole(before.get("steps")) or 0
        self._rigs[status.name] = dict(values)
        if not is_first:
            return  # round trips are shown of one
        if fresh < told:
            self.round_trips = []  # of another test
        elif fresh == told:
            return
        trip = _named(values, ROUND_TRIP)
        self.round_trips.append(
            (
                fresh * dt,
                trip.get("median (ms)"),
                trip.get("largest (ms)"),
                _whole(values.get("missed")) or 0,
            )
        )
        if len(self.round_trips) > 2 * EVENTS:
            del self.round_trips[1::2]  # older ones get thinner: memory is bounded

    def _note(self, what: str, detail: str, level: int) -> None:
        self._events.append(
            {"at": round(self._wall(), 3), "what": what, "detail": detail, "level": level}
        )


def _order(node: str) -> tuple[int, str]:
    return (NODES.index(bare(node)) if node else 0, node)


def _named(values: dict[str, str], start: str) -> dict[str, float]:
    found = {}
    for name, text in values.items():
        if name.startswith(start) and (value := _number(text)) is not None:
            found[name.removeprefix(start)] = value
    return found


def _number(text: str | None) -> float | None:
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if abs(value) < float("inf") else None


def _whole(text: str | None) -> int | None:
    return int(text) if text and text.isdecimal() and len(text) < 19 else None
