"""The end of a test, and the arrival of forces, in the last status of nodes: written and read."""

import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, field, fields
from enum import StrEnum

from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.messages import ERROR, OK, WARN, Status
from seft_msgs_py.wire.topics import Timebase, bare

RIG = "rig"
RECORDER_NODE_NAME = "recorder"
RECORDED = "recorded"
"""Key of the recorder's values: number of states of each rig in the bag, or safe in memory."""
FINISHED = "finished"
TRIPPED = "tripped"
STOPPED = "stopped"
"""Reason of a rig that obeyed the supervisor, which knows the cause."""
BY_OPERATOR = "stopped by the operator"
"""How a test ended that the operator stopped: it is done, and no trip."""
REHEARSES = "rehearses"
"""Key of the facts of a node of the loop: whether it can rehearse."""
REHEARSED = "rehearsal"
"""Key of the rig's facts: result of a rehearsal of the loop."""
ZEROED = "zeroed"
"""Key of the rig's facts: what it has measured at rest and subtracts."""
WAITS = "waits"
"""Key of a node's values: why it can't take part in a test now; empty if it can."""
STOPPING = "stopping"
"""Key of the rig's values: its test has ended, but its stop goes on."""
NOT_AT_REST = "not at rest"
"""Key of the rig's values: the stop has ended without rest, after this time."""
STALLED = "the supervisor has stalled; try again"
"""Why it refuses a request that may have waited for long: who waits still asks again."""
WAITED_KEY = "waited"
"""Key of a trip's values: how long a node waited in vain for others, s; 0: it knows the cause."""
STOOD_STILL_KEY = "stood_still"
"""Key of a node's values: how long its process neither waited nor worked just now, s; or 0."""
LISTED_STEPS = 100
"""Largest number of missed steps that a status lists; all are counted."""
ROUND_TRIPS = {
    "p50": "round trip median (ms)",
    "p90": "round trip 90 % (ms)",
    "p99": "round trip 99 % (ms)",
    "p99.9": "round trip 99.9 % (ms)",
    "largest": "round trip largest (ms)",
}
"""Quantiles of the time from a sample to its command, and their names in a status."""


class State(StrEnum):
    """States of a test."""

    IDLE = "idle"
    READY = "ready"
    RUNNING = "running"
    RAMPING_DOWN = "ramping_down"
    DONE = "done"
    TRIPPED = "tripped"


MOVING = (State.RUNNING, State.RAMPING_DOWN)
"""States in which the rig obeys commands."""
ENDED = (State.DONE, State.TRIPPED)
"""States that only a reset leaves."""


@dataclass(frozen=True)
class Trip:
    """Reason for the end of a test, in one line, with its step and experiment time.

    A reason that only says what did not come has the time ``waited`` for it, s: its cause is
    elsewhere.
    """

    reason: str
    step: int
    time_s: float
    waited: float = 0.0


Saturation = dict[str, dict[str, int]]
"""Saturated parts (stroke, valve, a sensor...): number of ``samples``, and ``first_step``."""


def count_saturated(found: Saturation, name: str, samples: int, first_step: int) -> None:
    """Add samples of one part, and the step of the first of them."""
    known = found.get(name, {"samples": 0, "first_step": first_step})
    first_step = min(known["first_step"], first_step)
    found[name] = {"samples": known["samples"] + samples, "first_step": first_step}


def all_saturated(parts: Iterable[Saturation]) -> Saturation:
    """Add up the samples of several rigs."""
    found: Saturation = {}
    for part in parts:
        for name, counts in part.items():
            count_saturated(found, name, **counts)
    return found


@dataclass(frozen=True)
class Simulated:
    """Largest true motion of a simulated rig in a test, its stop included, of any axis.

    Attributes
    ----------
    displacement_peak : float
        m.
    force_peak : float
        N.
    stop_force_peak : float
        From the trip, or the end of the test, until rest, N.
    """

    displacement_peak: float
    force_peak: float
    stop_force_peak: float

    @classmethod
    def of_all(cls, parts: Iterable["Simulated"]) -> "Simulated":
        """Give the largest of several rigs."""
        return cls(*map(max, zip(*map(astuple, parts), strict=True)))


class MissedSteps:
    """Steps without a new command, in their order.

    Parameters
    ----------
    rate : float
        Of the steps, Hz.

    Attributes
    ----------
    steps : list of int
        All of them.
    most : int
        The most of them within a second of the test, whichever.
    """

    def __init__(self, rate: float) -> None:
        self.steps: list[int] = []
        self.most = self._first = 0  # the first one of the last second
        self._second = round(rate)

    def add(self, step: int) -> None:
        """Count a step."""
        self.steps.append(step)
        while self.steps[self._first] <= step - self._second:
            self._first += 1
        self.most = max(self.most, len(self.steps) - self._first)


@dataclass(frozen=True)
class Outcome:
    """End of a test, as the rig reports it.

    Attributes
    ----------
    phase : str
        ``finished`` or ``tripped``.
    steps : int
        Samples that the rig took.
    missed : int
        Steps without a new command.
    missed_steps : list of int
        The first of them, at most `LISTED_STEPS`.
    wall_s : float or None
        Wall-clock duration of the test, s; None if it has not begun.
    trip : Trip or None
        Reason and time of an early end; None if finished.
    overruns : int
        Sampling overruns: steps at which the rig was late by more than half a period.
    saturation : Saturation
        Saturated parts.
    round_trips : dict
        From a sample to its command, s, by the keys of `ROUND_TRIPS`; empty if not measured.
    simulated : Simulated or None
        Largest true motion of a simulated rig; None if the rig is none.
    most_missed : int
        Missed steps within a second, see `MissedSteps`.
    """

    phase: str
    steps: int
    missed: int
    missed_steps: list[int]
    wall_s: float | None
    trip: Trip | None = None
    overruns: int = 0
    saturation: Saturation = field(default_factory=dict)
    round_trips: dict[str, float] = field(default_factory=dict)
    simulated: Simulated | None = None
    most_missed: int = 0

    @classmethod
    def of_all(cls, outcomes: Sequence["Outcome"]) -> "Outcome":
        """Combine the outcomes of all rigs of a test.

        The trip is the first one with a cause, the steps are those that all rigs have sampled,
        missed commands are added up, and the round trips are the longest.
        """
        if len(outcomes) == 1:
            return outcomes[0]
        trips = [outcome.trip for outcome in outcomes if outcome.trip is not None]
        causes = [trip for trip in trips if trip.reason != STOPPED] or trips
        simulated = [outcome.simulated for outcome in outcomes if outcome.simulated is not None]
        walls = [outcome.wall_s for outcome in outcomes if outcome.wall_s is not None]
        missed = {step for outcome in outcomes for step in outcome.missed_steps}
        return cls(
            phase=TRIPPED if trips else FINISHED,
            steps=min(outcome.steps for outcome in outcomes),
            missed=sum(outcome.missed for outcome in outcomes),
            missed_steps=sorted(missed)[:LISTED_STEPS],
            wall_s=max(walls, default=None),
            trip=min(causes, key=lambda trip: trip.step, default=None),
            overruns=sum(outcome.overruns for outcome in outcomes),
            saturation=all_saturated(outcome.saturation for outcome in outcomes),
            round_trips={
                key: max(found)
                for key in ROUND_TRIPS
                if (found := [o.round_trips[key] for o in outcomes if key in o.round_trips])
            },
            simulated=Simulated.of_all(simulated) if len(simulated) == len(outcomes) else None,
            most_missed=max(outcome.most_missed for outcome in outcomes),
        )


def rig_status(outcome: Outcome) -> Status:
    """Status of the rig in any phase; `read_outcome` reads it at the end of a test.

    Only the first `LISTED_STEPS` missed steps are sent. Before the end the outcome is that so far,
    with the phase. ValueError if there is a trip in another phase than ``tripped``, or none in it.
    """
    phase, trip = outcome.phase, outcome.trip
    if (phase == TRIPPED) != (trip is not None):
        raise ValueError(f"phase {phase} with trip {trip}")
    values = {
        "phase": phase,
        "steps": str(outcome.steps),
        "missed": str(outcome.missed),
        "most_missed": str(outcome.most_missed),
        "overruns": str(outcome.overruns),
        "missed_steps": ",".join(map(str, outcome.missed_steps[:LISTED_STEPS])),
        "saturated": json.dumps(dict(sorted(outcome.saturation.items()))),
    }
    if outcome.simulated is not None:
        values["simulated"] = json.dumps(asdict(outcome.simulated))
    for key, seconds in outcome.round_trips.items():
        values[ROUND_TRIPS[key]] = f"{seconds * 1e3:.3f}"
    if outcome.wall_s is not None:
        values["wall_s"] = repr(float(outcome.wall_s))
    message = f"{phase}: {outcome.steps} steps, {outcome.missed} missed"
    level = WARN if outcome.missed else OK
    if trip is not None:
        values.update(reason=trip.reason, step=str(trip.step), **{WAITED_KEY: f"{trip.waited:g}"})
        message = f"{phase} at step {trip.step} ({trip.time_s:g} s): {trip.reason}"
        level = ERROR
    return Status(name=RIG, level=level, message=message, values=values)


def tripped_status(node: str, reason: str, step: int, waited: float = 0.0) -> Status:
    """Status with which any node except the rig ends a test at once; ``waited`` as of `Trip`."""
    values = {"phase": TRIPPED, "reason": reason, "step": str(step), WAITED_KEY: f"{waited:g}"}
    return Status(node, ERROR, f"{TRIPPED} at step {step}: {reason}", values=values)


def seconds(status: Status, key: str) -> float:
    """Read a time of a status, s; 0 if it is not there, or none."""
    try:
        return _finite(status.values.get(key, "0"))
    except ValueError:
        return 0.0


def read_outcome(status: Status, timebase: Timebase) -> Outcome | None:
    """Read a status of `rig_status`; None if it is not of a rig at the end of a test.

    Raises
    ------
    WireError
        If it is one, and a value is missing or invalid.
    """
    values = status.values
    phase = values.get("phase", "")
    if bare(status.name) != RIG or phase not in (FINISHED, TRIPPED):
        return None
    try:
        trip, listed = None, values["missed_steps"]
        if phase == TRIPPED:
            step = int(values["step"])
            trip = Trip(values["reason"], step, timebase.stamp_ns(step) / 1e9)
        return Outcome(
            phase=phase,
            steps=int(values["steps"]),
            missed=int(values["missed"]),
            overruns=int(values.get("overruns", "0")),  # optional for a driver
            missed_steps=[*map(int, listed.split(","))] if listed else [],
            wall_s=float(values["wall_s"]) if "wall_s" in values else None,
            trip=trip,
            saturation={
                name: {key: int(counts[key]) for key in ("samples", "first_step")}
                for name, counts in json.loads(values.get("saturated", "{}")).items()
            },
            round_trips={
                key: _finite(values[name]) * 1e-3
                for key, name in ROUND_TRIPS.items()
                if name in values
            },
            simulated=_simulated(values["simulated"]) if "simulated" in values else None,
            most_missed=int(values.get("most_missed", "0")),
        )
    except KeyError as error:
        raise WireError(f"status of the {phase} rig: {error.args[0]} is missing") from None
    except (AttributeError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise WireError(f"status of the {phase} rig: {error}") from None


def _simulated(text: str) -> Simulated:
    values = json.loads(text)
    return Simulated(**{part.name: float(values[part.name]) for part in fields(Simulated)})


def _finite(text: str | float) -> float:
    if not math.isfinite(number := float(text)):
        raise ValueError(f"{text} is not finite")
    return number


@dataclass(frozen=True)
class LinkReport:
    """Ages of the messages from which the forces of a test were taken.

    Attributes
    ----------
    ages : mapping of int to int
        Steps between the step of a force and that of its message -> number of forces.
    held : int
        Forces without a message: the previous force was held.
    """

    ages: Mapping[int, int]
    held: int

    @classmethod
    def of_all(cls, reports: Iterable["LinkReport"]) -> "LinkReport":
        """Add up the reports of several rigs' force controllers."""
        parts = list(reports)
        ages = sum((Counter(part.ages) for part in parts), Counter())
        return cls(dict(sorted(ages.items())), sum(part.held for part in parts))

    def older_than(self, loop_delay: int) -> int:
        """Count the forces whose messages were older than the loop's delay: bridged ones."""
        return sum(count for age, count in self.ages.items() if age > loop_delay)

    def to_json(self) -> str:
        """Text for a status."""
        return json.dumps({"ages": dict(self.ages), "held": self.held})

    @classmethod
    def from_json(cls, text: str) -> "LinkReport":
        """Read a text of `to_json`.

        Raises
        ------
        ValueError
            If it is something else.
        """
        try:
            values = json.loads(text)
            ages = {int(age): int(count) for age, count in values["ages"].items()}
            return cls(ages, int(values["held"]))
        except (AttributeError, KeyError, TypeError, OverflowError, RecursionError) as error:
            raise ValueError(f"link: {error}") from None
