"""The response to the ground motion of a test, as far as that is known."""

from collections import deque

import numpy as np
import numpy.typing as npt
from seft_plant_sim.reference.whole_structure import RunningResponse

Floats = npt.NDArray[np.float64]

MOST_AT_ONCE = 4000
"""Steps: some milliseconds of work, also while it catches up with a test."""


class _Motion:
    """Ground motion from step 0 on, as it is published; what was used is forgotten."""

    def __init__(self) -> None:
        self._chunks: deque[Floats] = deque()
        self._known = 0  # steps
        self.used = 0

    def add(self, first: int, values: Floats) -> None:
        if first == self._known:  # without the first chunks nothing is known of the rest
            self._chunks.append(values)
            self._known += len(values)

    def take(self, until: int) -> Floats | None:
        """Take what follows, up to a step."""
        count = min(until, self._known) - self.used
        if count <= 0:
            return None
        parts: list[Floats] = []
        self.used += count
        while count:
            part = self._chunks.popleft()
            if len(part) > count:
                self._chunks.appendleft(part[count:])
                part = part[:count]
            parts.append(part)
            count -= len(part)
        return np.concatenate(parts)


class LiveReference:
    """Follows the ground motion of one test after another.

    The first of a test's motion comes before the test begins; to who listens only later it
    comes when it comes, all of it if the publisher still has all.

    Attributes
    ----------
    response : RunningResponse or None
        None: the structure is not known.
    """

    def __init__(self) -> None:
        self.response: RunningResponse | None = None
        self._now: _Motion | None = None
        self._coming: _Motion | None = None
        self._running = False

    def begin(self, response: RunningResponse | None) -> None:
        """Begin a test."""
        self.response = response
        if self._coming is not None or (self._now is not None and self._now.used):
            self._now, self._coming = self._coming, None
        self._running = True

    def motion(self, first: int, values: Floats) -> None:
        """Take in ground motion from a step on, shape (N, n), m/s^2."""
        if first == 0:
            fresh = _Motion()
            if self._running and (self._now is None or not self._now.used):
                self._now = fresh
            else:
                self._coming = fresh
        target = self._coming or self._now
        hopeless = target is self._now and self._running and self.response is None
        if target is not None and not hopeless:
            target.add(first, values)

    def advance(self, until: int) -> tuple[int, Floats, Floats, Floats] | None:
        """Go on to a step, as far as the motion is known and time allows.

        Returns
        -------
        first : int
            Step from which the response is new.
        motion, displacement, acceleration : ndarray
            Ground motion and response to it, shape (N, n), m and m/s^2; None if there is nothing
            new.
        """
        now = self._now
        if now is None or self.response is None:
            return None
        first = now.used
        motion = now.take(min(until, first + MOST_AT_ONCE))
        if motion is None:
            return None
        return (first, motion, *self.response.advance(motion))
