"""What the rig tells the diagnostics of a test while it runs and at its end."""

import math
import time
from collections.abc import Mapping
from dataclasses import replace

from seft_msgs_py.messages import WARN, Status

NARROW = 0.1  # of a limit: a smaller margin is warned of


def with_health(
    status: Status, margins: Mapping[str, float], answered_at: float, last_trip: float
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
    last_trip : float
        From a state to its command, s; nan where there was none.
    """
    values = {f"margin {name.replace('_', ' ')}": f"{left:.3f}" for name, left in margins.items()}
    narrow = [name.replace("_", " ") for name, left in margins.items() if not left >= NARROW]
    if answered_at:
        values["command age (ms)"] = f"{(time.monotonic() - answered_at) * 1e3:.2f}"
    if not math.isnan(last_trip):
        values["round trip last (ms)"] = f"{last_trip * 1e3:.3f}"
    message, level = status.message, status.level
    if narrow and level < WARN:
        level = WARN
        message += f"; less than {NARROW:.0%} left to the limit of {', '.join(narrow)}"
    return replace(status, level=level, message=message, values={**status.values, **values})
