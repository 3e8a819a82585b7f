"""The way of a reference force to zero."""

import math


def ramp_factor(taken: int, steps: int) -> float:
    """Factor of the ``taken``-th of some steps down: half a cosine."""
    return 0.5 * (1.0 + math.cos(math.pi * taken / steps))


class RampDown:
    """Factor that falls from 1 to 0 as half a cosine, counted in steps of the test.

    A step that is not taken does not count: a loop that stands still does not lose its ramp.

    Parameters
    ----------
    steps : int
        Steps from the first that is scaled to the one whose factor is 0, both included.
    rest : int
        Steps of factor 0 beyond that until the ramp counts as finished.

    Attributes
    ----------
    begun : bool
        Whether the ramp has been asked for.
    taken : int
        Factors given since then.
    steps : int
        As given.
    """

    def __init__(self, steps: int, rest: int = 0) -> None:
        if steps < 1:
            raise ValueError(f"a ramp of {steps} steps")
        self.steps, self._rest = steps, rest
        self.reset()

    @classmethod
    def lasting(cls, duration: float, dt: float, rest: int = 0) -> "RampDown":
        """Make one of a duration and a sampling period, both in s."""
        return cls(max(1, round(duration / dt)), rest)

    @property
    def finished(self) -> bool:
        """Whether the factor 0 has been given, and as often again as it must rest."""
        return self.taken >= self.steps + self._rest

    def reset(self) -> None:
        """Begin a new test."""
        self.begun = False
        self.taken = 0

    def begin(self) -> None:
        """Ask for the ramp; asking again does not begin it anew."""
        self.begun = True

    def next(self) -> float:
        """Factor of the next step: 1 before the ramp, 0 after it."""
        if not self.begun:
            return 1.0
        self.taken += 1
        return ramp_factor(self.taken, self.steps) if self.taken < self.steps else 0.0
