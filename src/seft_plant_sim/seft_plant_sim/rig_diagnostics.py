"""What the rig tells the diagnostics of a test while it runs and at its end."""

import math
import time
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import replace

from seft_msgs_py.wire.messages import WARN, Status

NARROW = 0.1  # of a limit: a smaller margin is warned of


def with_health(
    status: Status, margins: Mapping[str, float], answered_at: float, last_trip: float
) -> Status:
    """Add to a rig's status how well the test goes, under names that tools for diagnostics show.

    That is what `Limits.margins` gives, when the newest command came (s, monotonic; 0: none has),
    and the last time from a state to its command (s; nan: there was none).
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


SHORTEST = 1e-5  # s, lower edge of the first bin
PER_DECADE = 20  # bins: a median is right within 6 %
DECADES = 7
QUANTILES = {"p50": 0.5, "p90": 0.9, "p99": 0.99, "p99.9": 0.999}
EDGES = [SHORTEST * 10 ** (at / PER_DECADE) for at in range(1, PER_DECADE * DECADES)]


class RoundTrip:
    """Histogram of times with bins of equal ratio, and the last and the largest time.

    Attributes
    ----------
    last, largest : float
        s; nan where there was none.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget the test so far."""
        self._bins = [0] * (PER_DECADE * DECADES)
        self.count = 0
        self.last = self.largest = math.nan

    def add(self, time: float) -> None:
        """Count a time in seconds."""
        self._bins[bisect_right(EDGES, time)] += 1
        self.count += 1
        self.last = time
        self.largest = time if self.count == 1 else max(self.largest, time)

    def quantile(self, share: float) -> float:
        """Middle of the bin that holds a quantile, s; nan where there was no time.

        At most the largest time.
        """
        seen = 0
        for at, count in enumerate(self._bins):
            seen += count
            if seen >= share * self.count and seen:
                return float(min(SHORTEST * 10 ** ((at + 0.5) / PER_DECADE), self.largest))
        return math.nan

    def numbers(self) -> dict[str, float]:
        """Give quantiles and the largest, s, by the keys of `ROUND_TRIPS`; empty without a time."""
        if not self.count:
            return {}
        quantiles = {key: self.quantile(share) for key, share in QUANTILES.items()}
        return {**quantiles, "largest": self.largest}
