"""Where a force goes without a new one: it stays, a target brakes, and the way to zero."""

import math

import numpy as np
from seft_msgs_py.arrays import Floats, Ints
from seft_plant_sim.compiled import compiled, entry_point

BRAKING = 0.03
"""Time constant with which a target loses its velocity, s. At a sudden stop its oil would ring."""


@compiled
def go_on(points: Floats, age: int, dt: float, result: Floats) -> None:
    """Give points from a step on, whether they have been sent or not.

    Parameters
    ----------
    points : ndarray
        Those that have been sent, shape (p, q, n).
    age : int
        Steps after the first of them.
    dt : float
        Sampling period, s.
    result : ndarray
        The points wanted, shape (count, q, n).
    """
    last, (_, quantities, n) = len(points) - 1, points.shape
    for index in range(len(result)):
        sent, beyond = min(age + index, last), max(age + index - last, 0)
        left = math.exp(-beyond * dt / BRAKING)
        for i in range(n):
            for row in range(quantities):
                result[index, row, i] = points[sent, row, i]
            if quantities > 1:
                result[index, 0, i] += BRAKING * (1.0 - left) * points[sent, 1, i]
                result[index, 1, i] *= left


def continued(points: Floats, age: int, count: int, dt: float) -> Floats:
    """Give so many points, see `go_on`."""
    result = np.empty((count, *points.shape[1:]))
    go_on(points, age, dt, result)
    return result


BEGUN, TAKEN = range(2)
"""Places of what `next_factor` remembers: whether the ramp is asked for, and steps of it so far."""


@compiled
def ramp_factor(taken: int, steps: int) -> float:
    """Factor of the ``taken``-th of some steps down: half a cosine."""
    return 0.5 * (1.0 + math.cos(math.pi * taken / steps)) if taken < steps else 0.0


@compiled
def next_factor(steps: int, ramp: Ints) -> float:
    """Factor of the next step: 1 before the ramp, 0 after it.

    Parameters
    ----------
    steps : int
        Steps of the ramp.
    ramp : ndarray
        See `BEGUN`, shape (2,): brought up to date.
    """
    if not ramp[BEGUN]:
        return 1.0
    ramp[TAKEN] += 1
    return ramp_factor(ramp[TAKEN], steps)


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
    steps : int
        As given.
    state : ndarray
        What `next_factor` remembers.
    """

    def __init__(self, steps: int, rest: int = 0) -> None:
        if steps < 1:
            raise ValueError(f"a ramp of {steps} steps")
        self.steps, self.whole = steps, steps + rest
        self.state = np.zeros(2, dtype=np.int64)
        self._next = entry_point(next_factor, steps, self.state)

    @classmethod
    def lasting(cls, duration: float, dt: float, rest: int = 0) -> "RampDown":
        """Make one of a duration and a sampling period, both in s."""
        return cls(max(1, round(duration / dt)), rest)

    @property
    def begun(self) -> bool:
        """Whether the ramp has been asked for."""
        return bool(self.state[BEGUN])

    @property
    def taken(self) -> int:
        """Factors given since then."""
        return int(self.state[TAKEN])

    @property
    def finished(self) -> bool:
        """Whether the factor 0 has been given, and as often again as it must rest."""
        return self.taken >= self.whole

    def reset(self) -> None:
        """Begin a new test."""
        self.state[:] = 0

    def begin(self) -> None:
        """Ask for the ramp; asking again does not begin it anew."""
        self.state[BEGUN] = 1

    def next(self) -> float:
        """Take the factor of the next step, see `next_factor`."""
        factor: float = self._next(self.steps, self.state)
        return factor
