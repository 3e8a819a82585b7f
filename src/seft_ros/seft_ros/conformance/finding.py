"""The checks of a rig, what each found, and how to display it."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from rich.text import Text

Verdict = Literal["passed", "failed", "not run"]

_REFUSE = "refuse it, as seft_plant_sim.command.Command does: count it as a missing command"
_MOTION = {
    "description": "publish JSON with node and parameters on experiment/description, latched",
    "diagnostics": "send a status named rig with its phase five times a second",
    "silent before a test": "publish rig/state only while experiment/state is running or "
    "ramping_down",
    "form of rig/state": "one point with positions, velocities, accelerations and effort of each "
    "axis",
    "stamps": "stamp sample k with exactly k periods in integer nanoseconds, from 0 at the test's "
    "start; neither a wall clock nor floats (seft_msgs_py's TrajectoryCodec does)",
    "stays within limits": "look at the rig first; if it has not moved like this, that sensor's "
    "unit, sign or factor is wrong (mm for m?); else choose a smaller --amplitude",
    "end of a test": "end after as many states as experiment/state says (steps); report phase "
    "finished with seft_msgs_py's rig_status, and idle again when experiment/state is idle",
    "/clock": "publish the stamp of the last state on /clock, ten times a second",
    "period": "sample at absolute deadlines, start + k periods; a sleep of a period adds up",
    "late states": "",
    "at rest": "the valve is not at its centre, or something moves the rig: trim the valve's null",
    "follows the command": "is the pressure on? Then raise --amplitude",
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
    "command beyond the limit": "refuse it: a command beyond the limit is a fault",
    "watchdog: valve_command silent": "",
    "safe position": "bring the valve to its safe position in every trip, wait until the rig is at "
    "rest, and report 'stop time (s)' and 'stop peak force (N)' in the status of the trip",
    "trip is latched": "keep a trip until experiment/state is idle",
    "watchdog: supervisor silent": "",
    "stands still": "before each command check the age of the last new one, by a clock that does "
    "not stop, as seft_plant_sim.rig_watch.CommandWatch does",
    "rests when done": "end the test at once when experiment/state is done",
    "rests when tripped": "end the test at once when experiment/state is tripped",
    "rests in a test under way": "start only if experiment/state was ready before: a rig that "
    "starts late stays at rest",
}
CHECKS = {**_MOTION, **_OBEDIENCE}
"""Name of each check, and how to mend a failure; empty: it depends on what was measured."""
LATER = tuple(_OBEDIENCE)
"""Checks that are run only on a rig that has passed those before them."""


@dataclass(frozen=True)
class Finding:
    """One check.

    Attributes
    ----------
    check : str
        Its name.
    verdict : str
        ``passed``, ``failed`` or ``not run``.
    result : str
        The result, with the measured number; or why it was not run.
    mend : str
        What to do about a failure.
    measured : dict of str to float
        The numbers, by name with unit.
    """

    check: str
    verdict: Verdict
    result: str
    mend: str = ""
    measured: dict[str, float] = field(default_factory=dict)


def found(check: str, passed: bool, result: str, mend: str = "", **measured: float) -> Finding:
    """Make the finding of a check that was run; only of a failed one it says how to mend it."""
    mend = "" if passed else mend or CHECKS.get(check, "")
    return Finding(check, "passed" if passed else "failed", result, mend, measured)


def not_run(check: str, why: str) -> Finding:
    """Make the finding of a check that could not be run."""
    return Finding(check, "not run", why)


_MARKS = {
    "passed": ("passed ", "green"),
    "failed": ("FAILED ", "red"),
    "not run": ("not run", "dim"),
}


def finding_line(finding: Finding) -> Text:
    """Describe a finding in one line; below, how to mend it."""
    mark, colour = _MARKS[finding.verdict]
    text = Text.assemble((mark, f"bold {colour}"), f"  {finding.check}: {finding.result}")
    if finding.mend:
        text.append(f"\n           -> {finding.mend}")
    return text


def verdict(findings: Sequence[Finding]) -> dict[str, Any]:
    """Judge a rig by all findings; JSON values.

    Returns
    -------
    dict
        ``conforms``, how many checks ``passed``, ``failed`` and were ``not_run``, and ``checks``:
        of each ``check``, ``verdict``, ``result``, ``mend``, ``measured``.
    """
    counts = {
        word.replace(" ", "_"): sum(finding.verdict == word for finding in findings)
        for word in _MARKS
    }
    checks = [asdict(finding) | {"mend": finding.mend or None} for finding in findings]
    return {"conforms": not counts["failed"] and bool(findings), **counts, "checks": checks}
