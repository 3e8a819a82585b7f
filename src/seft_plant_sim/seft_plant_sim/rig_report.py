"""What a rig reports of its test: outcome so far, health, and how it came to rest."""

import math
from dataclasses import replace

from seft_msgs_py.wire.messages import ERROR, WARN, Status
from seft_msgs_py.wire.outcome import FINISHED, NOT_AT_REST, STOPPING, TRIPPED, Outcome, rig_status

from seft_plant_sim.hardware.safe_stop import Stopped
from seft_plant_sim.rig import Rig
from seft_plant_sim.rig_watch import RoundTrip

NARROW = 0.1  # of a limit: a smaller margin gives a warning


def rig_report(
    outcome: Outcome,
    rig: Rig,
    compute: RoundTrip,
    round_trip: RoundTrip,
    age: float,
    stopped: Stopped | None,
) -> Status:
    """Make the status of a test, with names for diagnostic tools.

    Parameters
    ----------
    outcome : Outcome
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
    status = rig_status(outcome)
    values, level = dict(status.values), status.level
    message = outcome.phase if outcome.phase == "running" else status.message
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
    if stopped is None and outcome.phase in (FINISHED, TRIPPED):
        values[STOPPING] = "until its valve is closed and it rests"
    elif stopped is not None:
        values["stop peak force (N)"] = f"{stopped.peak_force:.1f}"
        values["stop time (s)"] = f"{stopped.time:g}"
        if not stopped.is_at_rest:
            dumped = ", the pressure was dumped" if stopped.has_dumped else ""
            level, values[NOT_AT_REST] = ERROR, f"{stopped.time:.3g} s{dumped}"
            message += f"; not at rest after {values[NOT_AT_REST]}"
    narrow = [limit for limit, left in margins.items() if not left >= NARROW]
    if narrow and level < WARN:
        level = WARN
        message += f"; less than {NARROW:.0%} left to the limit of {', '.join(narrow)}"
    return replace(status, level=level, message=message, values=values)
