"""What the rig tells the diagnostics of a test while it runs and at its end."""

import time
from collections.abc import Mapping
from dataclasses import replace

from seft_msgs_py.messages import WARN, Status

from seft_plant_sim.round_trip import RoundTrip

NARROW = 0.1  # of a limit: a smaller margin is warned of


def with_health(
    status: Status, margins: Mapping[str, float], answered_at: float, round_trip: RoundTrip
) -> Status:
    """Add to a status how well the test goes, under names that tools for diagnostics show.

    Parameters
    ----------
    status : Status
        Of the rig.
    margins : mapping of str to float
        As `Limits.margins` gives them.
    answered_at : float
        When the newest command came, s, monotonic; 0 where none has come.
    round_trip : RoundTrip
        From a state to its command.
    """
    values = {f"margin {name.replace('_', ' ')}": f"{left:.3f}" for name, left in margins.items()}
    narrow = [name.replace("_", " ") for name, left in margins.items() if not left >= NARROW]
    if answered_at:
        values["command age (ms)"] = f"{(time.monotonic() - answered_at) * 1e3:.2f}"
    if round_trip.count:
        for name, seconds in (
            ("last", round_trip.last),
            ("median", round_trip.median()),
            ("largest", round_trip.largest),
        ):
            values[f"round trip {name} (ms)"] = f"{seconds * 1e3:.3f}"
    message, level = status.message, status.level
    if narrow and level < WARN:
        level = WARN
        message += f"; less than {NARROW:.0%} left to the limit of {', '.join(narrow)}"
    return replace(status, level=level, message=message, values={**status.values, **values})
