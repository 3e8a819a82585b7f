"""Whether a loop keeps its rate, by its rehearsal before anything moves."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from seft_msgs_py.config.parameter_table import parameter_rows
from seft_msgs_py.wire.outcome import REHEARSED, REHEARSES

PARAMETERS = parameter_rows(
    """
    rehearsal.duration | float | 2.0 | s | 0 .. 60 |
        for how long the loop is rehearsed in realtime before a test, with the valve at its safe
        value and the ground at rest; 0: not at all. A loop that does not keep its rate is refused
    """
)
UNFIT = "a loop that keeps its rate: "
"""Begin of what is missing if the rehearsal failed."""
RUNS = "the rehearsal of the loop"
"""What is missing while it goes on."""

LOOP = ("rig", "reference_force", "force_controller")
REFUSED = 0.1  # of the steps missed: a test of such a loop is another
WARNED = 0.001
ROOM = 0.8  # of a period, that the slowest hundredth may take at a rate that is proposed
_RATES = (5000.0, 2000.0, 1000.0, 500.0, 250.0, 200.0, 100.0, 50.0)  # Hz


@dataclass(frozen=True)
class Rehearsed:
    """What a rehearsal says: reasons to refuse a test, and to warn of it; empty if there are none.

    Without a rehearsal, ``asked`` is for how many s the rig shall rehearse; else 0.
    """

    refusal: str = ""
    warning: str = ""
    asked: float = 0.0


def judge(duration: float, nodes: Mapping[str, Mapping[str, Any]]) -> Rehearsed:
    """Judge the rehearsal of a loop.

    Parameters
    ----------
    duration : float
        That a rehearsal shall take, s; 0: none is wanted.
    nodes : mapping
        Name of each node of the test -> its description, in which one that can rehearse says so.
        There is a rehearsal if all nodes of one loop can: none over a link or with several rigs.
    """
    if not duration or not all(nodes.get(name, {}).get(REHEARSES) for name in LOOP):
        return Rehearsed()
    found = nodes["rig"].get(REHEARSED)
    if found is None:
        return Rehearsed(asked=duration)
    try:
        steps, missed, rate = (float(found[key]) for key in ("steps", "missed", "rate_hz"))
        slowest = float(found["round_trip_s"].get("p99", 0.0))
    except (KeyError, TypeError, ValueError, AttributeError):
        return Rehearsed("the rig tells a rehearsal that can't be read; see docs/hardware.md")
    if missed <= WARNED * steps:
        return Rehearsed()
    share = f"{missed:.0f} of {steps:.0f} steps without a command in time"
    trip = f"round trip p99 {1e3 * slowest:.2g} ms" if slowest else "no answer came in time"
    if missed < REFUSED * steps:
        return Rehearsed(warning=f"{rate:g} Hz is hard to keep here: {trip}, {share}")
    fits = [f"{r:g} Hz does" for r in _RATES if slowest and r < rate and slowest <= ROOM / r]
    mend = [*fits[:1], "seft run --composed, --priority or another host may (docs/realtime.md)"]
    return Rehearsed(f"{rate:g} Hz does not fit here: {trip}, {share}; {'; '.join(mend)}")
