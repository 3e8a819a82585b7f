"""How long states have failed to come, as the force controller sees it."""

import math


class Silence:
    """Time since the last state of a running test.

    A pause in which this process itself was held up counts as one look, as what had come
    meanwhile could not be seen.

    Parameters
    ----------
    longest : float
        Silence beyond which the test can't go on, s; infinite: never.
    """

    def __init__(self, longest: float) -> None:
        self.longest = longest
        self.pause = longest / 8
        """Longest time between two looks, s."""
        self._age = 0.0
        self._looked_at = math.inf  # nobody listens

    @property
    def is_watching(self) -> bool:
        """Whether a test runs, and states are to come."""
        return self._looked_at < math.inf

    def end(self) -> None:
        """Expect no more states."""
        self._looked_at = math.inf

    def heard(self, now: float) -> None:
        """Note a state at ``now``, s, monotonic: more are to come."""
        self._age, self._looked_at = 0.0, now

    def is_too_long(self, now: float) -> bool:
        """Look at the clock; say whether states have failed to come for too long."""
        if not self.is_watching:
            return False
        self._age += min(max(now - self._looked_at, 0.0), 2 * self.pause)
        self._looked_at = now
        return self._age > self.longest
