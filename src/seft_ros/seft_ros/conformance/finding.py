"""The checks of a rig's driver, and what each found."""

from dataclasses import dataclass, field
from typing import Literal

Verdict = Literal["passed", "failed", "not run"]

_REFUSE = "refuse it: seft_plant_sim.command.Command shows how; to the rig it is missing"
_MOTION = {
    "description": "publish JSON with node and parameters on experiment/description, latched",
    "diagnostics": "send a status named rig with its phase five times a second",
    "silent before a test": "publish rig/state only while experiment/state is running or "
    "ramping_down",
    "form of rig/state": "one point with positions, velocities, accelerations and effort of each "
    "axis",
    "stamps": "stamp sample k with exactly k periods in integer nanoseconds, from 0 at the test's "
    "start; neither a wall clock nor floats (seft_msgs_py's TrajectoryCodec does)",
    "stays within limits": "look at the rig first; if it has not moved so, that sensor's unit, "
    "sign or factor is wrong (mm for m?); else take a smaller --amplitude",
    "end of a test": "end after as many states as experiment/state says (steps); tell phase "
    "finished with seft_msgs_py's rig_status, and idle again when the supervisor says idle",
    "/clock": "publish the stamp of the last state on /clock, ten times a second",
    "period": "sample at absolute deadlines, start + k periods; a sleep of a period adds up",
    "late states": "",
    "at rest": "the valve is not at its centre, or something moves the rig: trim the valve's null",
    "moves as told": "is the pressure on? Then raise --amplitude",
    "velocity of displacement": "",
    "acceleration of velocity": "",
    "force of specimen": "",
    "answer applied": "apply the command that answers sample k from sample k+1 on, without a queue",
}
_OBEDIENCE = {
    "command stale": _REFUSE,
    "command a second time": _REFUSE,
    "command of the future": _REFUSE,
    "command of another axis": _REFUSE,
    "command not a number": _REFUSE,
    "command between two steps": _REFUSE,
    "command beyond the limit": "refuse it: a command beyond the limit is a fault, and no wish",
    "watchdog: valve_command silent": "",
    "safe position": "bring the valve to its safe position in every trip, follow the rig to rest, "
    "and tell 'stop time (s)' and 'stop peak force (N)' in the status of the trip",
    "trip is latched": "keep a trip until experiment/state is idle",
    "watchdog: supervisor silent": "",
    "stands still": "before each command look how long the last new one is ago, by a clock that "
    "goes on meanwhile: seft_plant_sim.rig_watch.CommandWatch shows how",
    "rests when done": "end the test at once when experiment/state is done",
    "rests when tripped": "end the test at once when experiment/state is tripped",
    "rests in a test under way": "begin only where experiment/state was ready before: a rig that "
    "comes up late rests",
}
CHECKS = {**_MOTION, **_OBEDIENCE}
"""Name of each check, and how to mend what it finds; empty: it tells by what it has measured."""
LATER = tuple(_OBEDIENCE)
"""Checks of a rig that has passed those before them."""


@dataclass(frozen=True)
class Finding:
    """One check.

    Attributes
    ----------
    check : str
        What was looked at.
    verdict : str
        ``passed``, ``failed`` or ``not run``.
    told : str
        What was seen, with the measured number; or why it was not run.
    mend : str
        What to do about a failure.
    measured : dict of str to float
        The numbers, by name with unit.
    """

    check: str
    verdict: Verdict
    told: str
    mend: str = ""
    measured: dict[str, float] = field(default_factory=dict)


def found(check: str, passed: bool, told: str, mend: str = "", **measured: float) -> Finding:
    """Make the finding of a check that was run; how to mend it is told where it failed."""
    mend = "" if passed else mend or CHECKS.get(check, "")
    return Finding(check, "passed" if passed else "failed", told, mend, measured)


def not_run(check: str, why: str) -> Finding:
    """Make the finding of a check that could not be run."""
    return Finding(check, "not run", why)
