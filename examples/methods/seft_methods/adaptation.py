"""Linear filters that request the force of a later instant, by a given or estimated delay.

An equation is written with the signals of a test as rows over a filter's columns; the result are
the gains of a linear filter, which may change during the test.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_ros.reference_force.compensation_methods import whole_steps
from seft_ros.reference_force.compensator import (
    Compensator,
    LinearCompensator,
    LinearFilter,
    MethodInputs,
)

from seft_methods.delay_estimate import EVERY, DelayEstimator
from seft_methods.settings import Settings, delay_range, read_settings
from seft_methods.signals import Memory

_GRID = 0.25  # sampling periods between the delays for which gains are computed

DelayFilter = tuple[Memory, Callable[[float], Floats]]
"""States of a linear filter; and from a delay (s) to its output gains, of shape (n, s + 4n +
(1 + preview) n)."""


def delay_method(
    design: Callable[[MethodInputs, int, Settings], DelayFilter],
) -> Callable[..., Compensator]:
    """Make a method from its filter, which ``design`` makes for delays up to some whole steps.

    The method takes the settings by name. It runs at `MethodInputs.delay`, or at the delay that
    is estimated on line; it raises `InputError` if no delay is known, or a setting is invalid.
    """

    def method(inputs: MethodInputs, **given: Any) -> Compensator:
        settings, delay, dt = read_settings(given), inputs.delay, inputs.dt
        if not settings["estimate_delay"]:
            memory, gains = design(inputs, whole_steps(delay, dt), settings)
            return LinearCompensator(memory.with_gains(gains(delay)))
        longest = whole_steps(delay_range(inputs, settings)[1], dt)
        return ScheduledCompensator(inputs, settings, *design(inputs, longest, settings))

    # not by functools.wraps: seft checks the settings against the signature
    method.__name__, method.__doc__ = design.__name__, design.__doc__
    return method


class AdaptiveCompensator(ABC):
    """Linear filter whose output gains follow estimates.

    Parameters
    ----------
    memory : Memory
        Its states.

    Attributes
    ----------
    preview : int
        Number of later steps whose ground motion it needs.
    """

    def __init__(self, memory: Memory) -> None:
        self._memory, self._gains = memory, self._present_gains()
        n, size = len(self._gains), len(memory.a)
        self._update = np.ascontiguousarray(np.hstack([memory.a, memory.b, memory.h]))
        self._inputs = memory.w.copy() if memory.w.any() else None
        self._work = np.zeros(self._gains.shape[1])
        self._remembered = self._work[: size + 5 * n]
        self._states, measured, ground = np.split(self._work, [size, size + 4 * n])
        self._measured, self._ground_motion = measured.reshape(4, n), ground.reshape(-1, n)
        self.preview = len(self._ground_motion) - 1

    @abstractmethod
    def _present_gains(self) -> Floats:
        """Gains at the present estimates, shape (n, s + 4n + (1 + preview) n)."""

    @abstractmethod
    def _adapt(self, reference: Floats, measured: Floats) -> bool:
        """Estimate with the forces of a step, shape (n,) each; whether the gains are due."""

    def reset(self) -> None:
        """Forget the test so far; the estimates have been reset before."""
        self._work[:] = 0.0
        self._gains = self._present_gains()

    def step(self, ground_motion: Floats, state: Floats) -> Floats:
        """Compute the reference force of one step, see `Compensator.step`."""
        self._measured[:] = state
        self._ground_motion[:] = ground_motion
        force: Floats = self._gains.dot(self._work)
        if len(self._states):
            states = self._update.dot(self._remembered)
            if self._inputs is not None:
                states += self._inputs.dot(force)
            self._states[:] = states
        if self._adapt(force, state[3]):
            self._gains = self._present_gains()
        return force

    def linear(self) -> LinearFilter:
        """Linear filter at the present estimates."""
        return self._memory.with_gains(self._present_gains())


class ScheduledCompensator(AdaptiveCompensator):
    """Delay compensation with the delay of each axis estimated on line.

    The gains are computed on a grid of delays, all of them before a test, and interpolated in
    between. The row of an axis is taken at that axis's delay.

    Parameters
    ----------
    inputs : MethodInputs
        Gives the first delay.
    settings : mapping
        Of the estimate.
    memory, gains
        The method, see `DelayFilter`.

    Raises
    ------
    InputError
        If parameters of the estimate are invalid.
    """

    def __init__(
        self,
        inputs: MethodInputs,
        settings: Settings,
        memory: Memory,
        gains: Callable[[float], Floats],
    ) -> None:
        self._first, last = delay_range(inputs, settings)
        self._estimator = DelayEstimator(inputs, settings)
        self._intervals = whole_steps(last - self._first, _GRID * inputs.dt)
        self._spacing = (last - self._first) / self._intervals
        self._on_grid = cache(lambda place: gains(self._first + self._spacing * place))
        self._step = 0
        super().__init__(memory)

    def reset(self) -> None:
        """Forget the test so far, and the estimated delay."""
        self._estimator.reset()
        self._step = 0
        for place in range(self._intervals + 1):
            self._on_grid(place)
        super().reset()

    def estimates(self) -> dict[str, Floats]:
        """Delay of each axis (s), as ``delay``."""
        return {"delay": self._estimator.delay.copy()}

    def _adapt(self, reference: Floats, measured: Floats) -> bool:
        self._estimator.step(reference, measured)
        self._step = (self._step + 1) % EVERY
        return self._step == EVERY - 1

    def _present_gains(self) -> Floats:
        position = (self._estimator.delay - self._first) / self._spacing
        places = np.clip(position.astype(int), 0, self._intervals - 1)
        part = (position - places)[:, np.newaxis]
        below, above = (
            np.array([self._on_grid(place)[axis] for axis, place in enumerate(near.tolist())])
            for near in (places, places + 1)
        )
        gains: Floats = (1 - part) * below + part * above
        return gains
