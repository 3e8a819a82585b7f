"""The points after the last ones: a force stays, a target brakes; and the ramp to zero."""

import math

import numpy as np
from seft_msgs_py.arrays import Floats, Ints
from seft_plant_sim.compiled import compiled, entry_point

BRAKING = 0.03
"""Time constant of a target's braking, s. At a sudden stop the oil column would ring."""


@compiled
def go_on(points: Floats, age: int, dt: float, result: Floats) -> None:
    """Give points from a step on; points that were not sent are extrapolated.

    Parameters
    ----------
    points : ndarray
        The sent points, shape (p, q, n).
    age : int
        Steps after the first of them.
    dt : float
        Sampling period, s.
    result : ndarray
        The result, shape (count, q, n).
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
    """Give ``count`` points, see `go_on`."""
    result = np.empty((count, *points.shape[1:]))
    go_on(points, age, dt, result)
    return result


BEGUN, TAKEN = range(2)
"""Places of the state of `next_factor`: whether the ramp has begun, and its steps so far."""


@compiled
def ramp_factor(taken: int, steps: int) -> float:
    """Factor of step ``taken`` of a ramp of some steps: half a cosine."""
    return 0.5 * (1.0 + math.cos(math.pi * taken / steps)) if taken < steps else 0.0


@compiled
def next_factor(steps: int, ramp: Ints) -> float:
    """Factor of the next step: 1 before the ramp, 0 after it.

    Parameters
    ----------
    steps : int
        Steps of the ramp.
    ramp : ndarray
        See `BEGUN`, shape (2,); updated.
    """
    if not ramp[BEGUN]:
        return 1.0
    ramp[TAKEN] += 1
    return ramp_factor(ramp[TAKEN], steps)


class RampDown:
    """Factor that falls from 1 to 0 as half a cosine, counted in steps of the test.

    Steps count, not time: if the loop stalls, the ramp continues after the stall.

    Parameters
    ----------
    steps : int
        Steps from the first scaled one to the one of factor 0, both included.
    rest : int
        Further steps of factor 0 until the ramp is finished.

    Attributes
    ----------
    steps : int
        As given.
    state : ndarray
        State of `next_factor`.
    """

    def __init__(self, steps: int, rest: int = 0) -> None:
        if steps < 1:
            raise ValueError(f"a ramp of {steps} steps")
        self.steps, self.whole = steps, steps + rest
        self.state = np.zeros(2, dtype=np.int64)
        self._next = entry_point(next_factor, steps, self.state)

    @classmethod
    def lasting(cls, duration: float, dt: float, rest: int = 0) -> "RampDown":
        """Make one from a duration and a sampling period, both in s."""
        return cls(max(1, round(duration / dt)), rest)

    @property
    def begun(self) -> bool:
        """Whether the ramp has begun."""
        return bool(self.state[BEGUN])

    @property
    def taken(self) -> int:
        """Number of factors given since then."""
        return int(self.state[TAKEN])

    @property
    def finished(self) -> bool:
        """Whether the factor 0 has been given, and then for `rest` steps."""
        return self.taken >= self.whole

    def reset(self) -> None:
        """Begin a new test."""
        self.state[:] = 0

    def begin(self) -> None:
        """Begin the ramp; a second call has no effect."""
        self.state[BEGUN] = 1

    def next(self) -> float:
        """Take the factor of the next step, see `next_factor`."""
        factor: float = self._next(self.steps, self.state)
        return factor
