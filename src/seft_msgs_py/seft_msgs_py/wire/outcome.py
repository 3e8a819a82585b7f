"""How a test ended: what the rig's last status says of it, written and read here alone."""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.messages import ERROR, OK, WARN, Status
from seft_msgs_py.wire.rigs import bare
from seft_msgs_py.wire.timebase import Timebase

RIG = "rig"
FINISHED = "finished"
TRIPPED = "tripped"
STOPPED = "stopped"
"""Reason of a rig that only did what the supervisor said: that one knows why."""
LISTED_STEPS = 100
"""Missed steps that a status lists; all are counted."""
ROUND_TRIPS = {
    "p50": "round trip median (ms)",
    "p90": "round trip 90 % (ms)",
    "p99": "round trip 99 % (ms)",
    "p99.9": "round trip 99.9 % (ms)",
    "largest": "round trip largest (ms)",
}
"""Quantiles of the time from a sample to its command, and how a status names them."""


@dataclass(frozen=True)
class Trip:
    """Why and when a test was ended by a limit or a fault.

    Attributes
    ----------
    reason : str
        One line: limit, value and axis, or the fault.
    step : int
        Step at which it was seen.
    time_s : float
        Experiment time of that step.
    """

    reason: str
    step: int
    time_s: float


@dataclass(frozen=True)
class Saturation:
    """What was at the end of its range in a test: stroke, valve, a sensor...

    Attributes
    ----------
    samples : dict
        Name -> number of samples.
    first_step : dict
        Name -> the first of these steps.
    """

    samples: dict[str, int] = field(default_factory=dict)
    first_step: dict[str, int] = field(default_factory=dict)

    def add(self, step: int, names: Iterable[str]) -> None:
        """Count what is at the end of its range at a step."""
        for name in set(names):
            self.samples[name] = self.samples.get(name, 0) + 1
            self.first_step.setdefault(name, step)

    @classmethod
    def of_all(cls, parts: Iterable["Saturation"]) -> "Saturation":
        """Add up what several rigs tell; a rig's sample counts for itself."""
        found = cls()
        for part in parts:
            for name, samples in part.samples.items():
                first = part.first_step[name]
                found.samples[name] = found.samples.get(name, 0) + samples
                found.first_step[name] = min(found.first_step.get(name, first), first)
        return found

    def to_json(self) -> str:
        """Text: name -> samples and first_step."""
        named = sorted(self.samples)
        return json.dumps(
            {n: {"samples": self.samples[n], "first_step": self.first_step[n]} for n in named}
        )

    @classmethod
    def from_json(cls, text: str) -> "Saturation":
        """Read what `to_json` wrote.

        Raises
        ------
        ValueError
            If it is something else.
        """
        found = cls()
        try:
            for name, counts in json.loads(text).items():
                found.samples[str(name)] = int(counts["samples"])
                found.first_step[str(name)] = int(counts["first_step"])
        except (AttributeError, KeyError, TypeError, OverflowError, RecursionError) as error:
            raise ValueError(f"saturated: {error}") from None
        return found


@dataclass(frozen=True)
class Outcome:
    """End of a test, as the rig saw it.

    Attributes
    ----------
    phase : str
        ``finished`` or ``tripped``.
    steps : int
        Samples that the rig took.
    missed : int
        Steps at which it had no new command and held the last.
    missed_steps : list of int
        The first of them, at most `LISTED_STEPS`.
    wall_s : float or None
        Wall-clock duration of the test.
    trip : Trip or None
        Why and when it was ended early; None if finished.
    overruns : int
        Times the rig's own clock was held up for more than half a period.
    saturation : Saturation
        What was at the end of its range.
    round_trips : dict
        From a sample to its command as the rig measured it, s, by the keys of `ROUND_TRIPS`;
        empty where it did not.
    """

    phase: str
    steps: int
    missed: int
    missed_steps: list[int]
    wall_s: float | None
    trip: Trip | None
    overruns: int = 0
    saturation: Saturation = field(default_factory=Saturation)
    round_trips: dict[str, float] = field(default_factory=dict)

    @classmethod
    def of_all(cls, outcomes: Sequence["Outcome"]) -> "Outcome":
        """Put together how a test ended for each of its rigs; the first trip with a cause counts.

        The steps are those that all rigs have sampled; what they missed is added up; of the round
        trips the longest are told.
        """
        if len(outcomes) == 1:
            return outcomes[0]
        trips = [outcome.trip for outcome in outcomes if outcome.trip is not None]
        causes = [trip for trip in trips if trip.reason != STOPPED] or trips
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
            saturation=Saturation.of_all([outcome.saturation for outcome in outcomes]),
            round_trips={
                key: max(found)
                for key in ROUND_TRIPS
                if (found := [o.round_trips[key] for o in outcomes if key in o.round_trips])
            },
        )


def rig_status(
    phase: str,
    steps: int,
    missed: int,
    missed_steps: Sequence[int],
    wall_s: float | None,
    trip: Trip | None = None,
    *,
    overruns: int = 0,
    saturation: Saturation | None = None,
    round_trips: Mapping[str, float] | None = None,
) -> Status:
    """Status of the rig in any phase; in the last, `read_outcome` understands it.

    Parameters
    ----------
    phase : str
        ``finished``, ``tripped``, or a phase before the end.
    steps, missed : int
        Samples taken, and steps at which the last command was held.
    missed_steps : sequence of int
        Those steps; the first `LISTED_STEPS` are told.
    wall_s : float or None
        Wall-clock time since the test began, s; None if it has not.
    trip : Trip, optional
        Needed where the phase is ``tripped``.
    overruns : int
        Times the rig's own clock was held up for more than half a period.
    saturation : Saturation, optional
        What was at the end of its range; default nothing.
    round_trips : mapping, optional
        As `Outcome` has them.

    Raises
    ------
    ValueError
        If there is a trip in another phase than ``tripped``, or none in that.
    """
    if (phase == TRIPPED) != (trip is not None):
        raise ValueError(f"phase {phase} with trip {trip}")
    values = {
        "phase": phase,
        "steps": str(int(steps)),
        "missed": str(int(missed)),
        "overruns": str(int(overruns)),
        "missed_steps": ",".join(str(int(step)) for step in missed_steps[:LISTED_STEPS]),
        "saturated": (saturation or Saturation()).to_json(),
    }
    for key, seconds in (round_trips or {}).items():
        values[ROUND_TRIPS[key]] = f"{seconds * 1e3:.3f}"
    if wall_s is not None:
        values["wall_s"] = repr(float(wall_s))
    message = f"{phase}: {steps} steps, {missed} missed"
    level = WARN if missed else OK
    if trip is not None:
        values.update(reason=trip.reason, step=str(int(trip.step)))
        message = f"{phase} at step {trip.step} ({trip.time_s:g} s): {trip.reason}"
        level = ERROR
    return Status(name=RIG, level=level, message=message, values=values)


def tripped_status(node: str, reason: str, step: int) -> Status:
    """Status with which any node but the rig ends a test, at once; the supervisor obeys it."""
    values = {"phase": TRIPPED, "reason": reason, "step": str(step)}
    return Status(node, ERROR, f"{TRIPPED} at step {step}: {reason}", values=values)


def read_outcome(status: Status, timebase: Timebase) -> Outcome | None:
    """Read what `rig_status` wrote.

    Returns
    -------
    Outcome or None
        None if it is not a rig's status, or the test has not ended with it.

    Raises
    ------
    WireError
        If it is the end of a test, and a value is missing or makes no sense.
    """
    values = status.values
    phase = values.get("phase", "")
    if bare(status.name) != RIG or phase not in (FINISHED, TRIPPED):
        return None
    try:
        listed = values["missed_steps"]
        trip = None
        if phase == TRIPPED:
            step = int(values["step"])
            trip = Trip(values["reason"], step, timebase.stamp_ns(step) / 1e9)
        return Outcome(
            phase=phase,
            steps=int(values["steps"]),
            missed=int(values["missed"]),
            overruns=int(values.get("overruns", "0")),  # a driver may have no such thing
            missed_steps=[int(step) for step in listed.split(",")] if listed else [],
            wall_s=float(values["wall_s"]) if "wall_s" in values else None,
            trip=trip,
            saturation=Saturation.from_json(values.get("saturated", "{}")),
            round_trips={
                key: _finite(values[name]) * 1e-3
                for key, name in ROUND_TRIPS.items()
                if name in values
            },
        )
    except KeyError as error:
        raise WireError(f"status of the {phase} rig: {error.args[0]} is missing") from None
    except ValueError as error:
        raise WireError(f"status of the {phase} rig: {error}") from None


def _finite(text: str) -> float:
    if not math.isfinite(number := float(text)):
        raise ValueError(f"{text} is not finite")
    return number
