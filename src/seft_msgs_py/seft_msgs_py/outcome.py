"""How a test ended: what the rig's last status says of it, written and read here alone."""

from collections.abc import Sequence
from dataclasses import dataclass

from seft_msgs_py.errors import WireError
from seft_msgs_py.messages import ERROR, OK, WARN, Status
from seft_msgs_py.timebase import Timebase

RIG = "rig"
FINISHED = "finished"
TRIPPED = "tripped"
LISTED_STEPS = 100
"""Missed steps that a status lists; all are counted."""


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
        Times the rig's own clock was held up for more than a period.
    """

    phase: str
    steps: int
    missed: int
    missed_steps: list[int]
    wall_s: float | None
    trip: Trip | None
    overruns: int = 0


def rig_status(
    phase: str,
    steps: int,
    missed: int,
    missed_steps: Sequence[int],
    wall_s: float | None,
    trip: Trip | None = None,
    *,
    overruns: int = 0,
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
        Times the rig's own clock was held up for more than a period.

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
    }
    if wall_s is not None:
        values["wall_s"] = repr(float(wall_s))
    message = f"{phase}: {steps} steps, {missed} missed"
    level = WARN if missed else OK
    if trip is not None:
        values.update(reason=trip.reason, step=str(int(trip.step)))
        message = f"{phase} at step {trip.step}: {trip.reason}"
        level = ERROR
    return Status(name=RIG, level=level, message=message, values=values)


def read_outcome(status: Status, timebase: Timebase) -> Outcome | None:
    """Read what `rig_status` wrote.

    Returns
    -------
    Outcome or None
        None if it is not the rig's status, or the test has not ended with it.

    Raises
    ------
    WireError
        If it is the end of a test, and a value is missing or makes no sense.
    """
    values = status.values
    phase = values.get("phase", "")
    if status.name != RIG or phase not in (FINISHED, TRIPPED):
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
        )
    except KeyError as error:
        raise WireError(f"status of the {phase} rig: {error.args[0]} is missing") from None
    except ValueError as error:
        raise WireError(f"status of the {phase} rig: {error}") from None
