"""Methods that ask for the force of a later instant, by a delay that is given or followed.

An equation is written with the signals of a test as rows over a filter's columns; what comes of it
are the gains of a linear filter, which may change while it runs.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps

import numpy as np
from seft_msgs_py.config.arrays import Floats
from seft_msgs_py.errors import InputError

from seft_ros.reference_force.compensator import (
    Compensator,
    Knowledge,
    LinearCompensator,
    LinearFilter,
    Method,
)
from seft_ros.reference_force.delay_estimator import EVERY, DelayEstimator, whole_steps

_GRID = 0.25  # sampling periods between the delays that gains are computed for


def between_samples(steps: float, count: int) -> Floats:
    """Weights of ``count`` samples for the value ``steps`` after the first: linear interpolation.

    Returns
    -------
    ndarray
        Shape (count,); beyond the last sample they give that one.
    """
    weights: Floats = np.maximum(0.0, 1.0 - np.abs(np.arange(count) - min(steps, count - 1.0)))
    return weights


@dataclass(frozen=True)
class Signals:
    """Each signal as a matrix of n rows over the columns (s, y, g) of `LinearFilter.matrix`.

    What is added and multiplied by matrices with these is a gain matrix in the end.

    Attributes
    ----------
    knowledge : Knowledge
        The test.
    preview : int
        Coming steps of the ground motion among the columns.
    blocks : int
        Blocks of n states among them.
    """

    knowledge: Knowledge
    preview: int
    blocks: int = 0

    def state(self, block: int) -> Floats:
        """Block of states, shape (n, columns)."""
        return self._rows(block)

    @property
    def displacement(self) -> Floats:
        """Measured displacement x, shape (n, columns)."""
        return self._rows(self.blocks)

    @property
    def velocity(self) -> Floats:
        """Measured velocity v, shape (n, columns)."""
        return self._rows(self.blocks + 1)

    @property
    def acceleration(self) -> Floats:
        """Measured acceleration a, shape (n, columns)."""
        return self._rows(self.blocks + 2)

    @property
    def restoring_force(self) -> Floats:
        """Measured restoring force r = f - M_e a, shape (n, columns)."""
        return self._rows(self.blocks + 3) - self.knowledge.mass @ self.acceleration

    def ground_motion(self, time: float) -> Floats:
        """Ground acceleration ``time`` seconds from now, shape (n, columns)."""
        n = self.knowledge.axes
        weights = between_samples(time / self.knowledge.dt, 1 + self.preview)
        return np.hstack([np.zeros((n, (self.blocks + 4) * n)), np.kron(weights, np.eye(n))])

    def _rows(self, block: int) -> Floats:
        n = self.knowledge.axes
        return np.eye(n, (self.blocks + 5 + self.preview) * n, k=block * n)


@dataclass(frozen=True)
class Memory:
    """What a filter of n axes remembers, whatever its output gains are.

    ::

        f_r[k] = gains (s[k], y[k], g[k...])
        s[k+1] = a s[k] + b y[k] + h g[k] + w f_r[k]

    The states s mean the same at all gains, and so remain right while these change.

    Attributes
    ----------
    a, b, h, w : ndarray
        Shapes (s, s), (s, 4n), (s, n) and (s, n).
    """

    a: Floats
    b: Floats
    h: Floats
    w: Floats

    @classmethod
    def none(cls, axes: int) -> "Memory":
        """Nothing is remembered."""
        return cls(*(np.zeros((0, columns)) for columns in (0, 4 * axes, axes, axes)))

    @classmethod
    def past(cls, signal: Floats, blocks: int) -> "Memory":
        """Last values of a signal, the newest first.

        Parameters
        ----------
        signal : ndarray
            The signal of the measured y and the ground acceleration g[k], shape (n, 5n).
        blocks : int
            Number of values.
        """
        n = len(signal)
        size = blocks * n
        newest = np.zeros((size, 5 * n))
        newest[:n] = signal
        b, h = newest[:, : 4 * n], newest[:, 4 * n :]
        return cls(np.eye(size, k=-n), b, h, np.zeros((size, n)))

    def with_gains(self, gains: Floats) -> LinearFilter:
        """Linear filter that it is with gains of shape (n, s + 4n + (1 + preview) n)."""
        size, measured = self.b.shape
        c, d, e = np.split(gains, [size, size + measured], axis=1)
        w, h = self.w, self.w @ e
        h[:, : self.h.shape[1]] += self.h
        return LinearFilter(self.a + w @ c, self.b + w @ d, h, c, d, e)


class VaryingFilter:
    """A `Memory` at work, with gains that may be set between two steps.

    Parameters
    ----------
    memory : Memory
        What it remembers.
    gains : ndarray
        First gains, shape (n, s + 4n + (1 + preview) n).

    Attributes
    ----------
    gains : ndarray
        Present gains, of the same shape.
    preview : int
        Steps of coming ground motion that it looks at.
    """

    def __init__(self, memory: Memory, gains: Floats) -> None:
        self.gains = gains
        n, size = len(gains), len(memory.a)
        self._update = np.ascontiguousarray(np.hstack([memory.a, memory.b, memory.h]))
        self._inputs = memory.w.copy() if memory.w.any() else None
        self._work = np.zeros(gains.shape[1])
        self._states = self._work[:size]
        self._measured = self._work[size : size + 4 * n].reshape(4, n)
        self._remembered = self._work[: size + 5 * n]
        self._ground_motion = self._work[size + 4 * n :].reshape(-1, n)
        self.preview = len(self._ground_motion) - 1

    def reset(self) -> None:
        """Forget the test so far."""
        self._work[:] = 0.0

    def step(self, ground_motion: Floats, state: Floats) -> Floats:
        """Compute the reference force of one step, see `Compensator.step`."""
        self._measured[:] = state
        self._ground_motion[:] = ground_motion
        force: Floats = self.gains.dot(self._work)
        if len(self._states):
            states = self._update.dot(self._remembered)
            if self._inputs is not None:
                states += self._inputs.dot(force)
            self._states[:] = states
        return force


@dataclass(frozen=True)
class DelayFilter:
    """Linear filter of which the output gains alone depend on the delay.

    Attributes
    ----------
    memory : Memory
        Its states.
    gains : callable
        From a delay (s) to gains of shape (n, s + 4n + (1 + preview) n).
    """

    memory: Memory
    gains: Callable[[float], Floats]


def delay_method(design: Callable[[Knowledge, int], DelayFilter]) -> Method:
    """Make a method of its filter, which ``design`` makes for delays up to some whole steps.

    It runs at ``compensation.delay``, or at the delay that is estimated on line; it raises
    `InputError` if no delay is given, or the parameters of the estimate make no sense.
    """

    @wraps(design)
    def method(knowledge: Knowledge) -> Compensator:
        delay, dt = given_delay(knowledge), knowledge.dt
        if not knowledge.options["compensation.estimate_delay"]:
            fixed = design(knowledge, whole_steps(delay, dt))
            return LinearCompensator(fixed.memory.with_gains(fixed.gains(delay)))
        longest = delay_range(knowledge)[1]
        return ScheduledCompensator(knowledge, design(knowledge, whole_steps(longest, dt)))

    return method


def given_delay(knowledge: Knowledge) -> float:
    """Delay that is to be compensated, s.

    Raises
    ------
    InputError
        If none is given.
    """
    delay = float(knowledge.options["compensation.delay"])
    if delay <= 0:
        raise InputError(
            f"reference_force: compensation.method {knowledge.options['compensation.method']} "
            "needs compensation.delay, the delay from reference force to measured force; "
            "seft identify finds it and writes it into model.yaml, to be read by --params-file"
        )
    return delay


def delay_range(knowledge: Knowledge) -> tuple[float, float]:
    """Shortest and longest delay that an adaptive method may take, s.

    Raises
    ------
    InputError
        If they make no range, or the given delay is outside.
    """
    bounds = list(np.atleast_1d(knowledge.options["compensation.delay_range"]).tolist())
    if len(bounds) != 2 or not 0 < bounds[0] < bounds[1]:
        raise InputError(
            f"reference_force: compensation.delay_range is {bounds}, but must be two delays in s "
            "above zero, the shorter first"
        )
    delay = given_delay(knowledge)
    if not bounds[0] <= delay <= bounds[1]:
        raise InputError(
            f"reference_force: compensation.delay is {delay:g} s, where the estimate starts, but "
            f"compensation.delay_range is {bounds}; widen it"
        )
    return bounds[0], bounds[1]


class ScheduledCompensator:
    """Delay compensation that follows the delay of each axis as it is estimated on line.

    The gains are computed beforehand on a grid of delays; between two of them they are
    interpolated. The row of an axis is taken at that axis's delay.

    Parameters
    ----------
    knowledge : Knowledge
        Its options hold the first delay and the bounds.
    delay_filter : DelayFilter
        The method.

    Raises
    ------
    InputError
        If parameters of the estimate make no sense.
    """

    def __init__(self, knowledge: Knowledge, delay_filter: DelayFilter) -> None:
        self._first, last = delay_range(knowledge)
        self._estimator = DelayEstimator(
            start=given_delay(knowledge),
            bounds=(self._first, last),
            rate=knowledge.options["compensation.delay_rate"],
            excitation=knowledge.options["compensation.excitation"],
            band=knowledge.options["compensation.band"],
            dt=knowledge.dt,
            axes=knowledge.axes,
        )
        count = 1 + whole_steps(last - self._first, _GRID * knowledge.dt)
        self._spacing = (last - self._first) / (count - 1)
        grid = self._first + self._spacing * np.arange(count)
        self._table = np.array([delay_filter.gains(float(delay)) for delay in grid])
        self._memory = delay_filter.memory
        self._filter = VaryingFilter(self._memory, self._gains())
        self.preview = self._filter.preview
        self._step = 0

    def reset(self) -> None:
        """Forget the test so far, and the estimated delay."""
        self._filter.reset()
        self._estimator.reset()
        self._filter.gains = self._gains()
        self._step = 0

    def step(self, ground_motion: Floats, state: Floats) -> Floats:
        """Compute the reference force of one step, see `Compensator.step`."""
        force = self._filter.step(ground_motion, state)
        self._estimator.step(force, state[3])
        self._step = (self._step + 1) % EVERY
        if self._step == EVERY - 1:
            self._filter.gains = self._gains()
        return force

    def estimates(self) -> dict[str, Floats]:
        """Delay of each axis (s), as ``delay``."""
        return {"delay": self._estimator.delay.copy()}

    def linear(self) -> LinearFilter:
        """Linear filter at the delays estimated now."""
        return self._memory.with_gains(self._gains())

    def _gains(self) -> Floats:
        """Gains at the present delays."""
        position = (self._estimator.delay - self._first) / self._spacing
        index = np.clip(position.astype(int), 0, len(self._table) - 2)
        axes, part = np.arange(len(index)), (position - index)[:, np.newaxis]
        table = self._table
        gains: Floats = (1 - part) * table[index, axes] + part * table[index + 1, axes]
        return gains
