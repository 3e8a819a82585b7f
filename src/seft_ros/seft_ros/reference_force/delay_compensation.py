"""Methods that ask for the force of a later instant, by a delay that is given or followed.

An equation is written with the signals of a test as rows over a filter's columns; what comes of it
are the gains of a linear filter, which may change while it runs.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps

import numpy as np
from seft_msgs_py.config.parameter_table import Floats
from seft_msgs_py.errors import InputError

from seft_ros.reference_force.compensator import Compensator, Knowledge, Method
from seft_ros.reference_force.delay_estimator import EVERY, DelayEstimator, whole_steps
from seft_ros.reference_force.linear_filter import (
    LinearCompensator,
    LinearFilter,
    Memory,
    VaryingFilter,
)

_GRID = 0.25  # sampling periods between the delays that gains are computed for


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
