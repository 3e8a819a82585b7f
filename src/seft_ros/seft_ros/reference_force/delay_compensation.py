"""Methods that request the force of a later instant, by a given or estimated delay; and ATS.

An equation is written with the signals of a test as rows over a filter's columns; the result are
the gains of a linear filter, which may change during the test.
"""

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from functools import wraps

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from seft_msgs_py.arrays import Floats

from seft_ros.reference_force.compensator import Compensator, Knowledge, Method, Signals
from seft_ros.reference_force.linear_filter import LinearCompensator, LinearFilter, Memory
from seft_ros.reference_force.observers import EVERY, DelayEstimator, ForceBlocks, whole_steps

_GRID = 0.25  # sampling periods between the delays for which gains are computed


DelayFilter = tuple[Memory, Callable[[float], Floats]]
"""States of a linear filter; and from a delay (s) to its output gains, of shape (n, s + 4n +
(1 + preview) n)."""


def delay_method(design: Callable[[Knowledge, int], DelayFilter]) -> Method:
    """Make a method from its filter, which ``design`` makes for delays up to some whole steps.

    It runs at ``compensation.delay``, or at the delay that is estimated on line; it raises
    `InputError` if no delay is given, or the parameters of the estimate are invalid.
    """

    @wraps(design)
    def method(knowledge: Knowledge) -> Compensator:
        delay, dt = knowledge.delay, knowledge.dt
        if not knowledge.options["compensation.estimate_delay"]:
            memory, gains = design(knowledge, whole_steps(delay, dt))
            return LinearCompensator(memory.with_gains(gains(delay)))
        longest = knowledge.delay_range[1]
        return ScheduledCompensator(knowledge, *design(knowledge, whole_steps(longest, dt)))

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

    The gains are computed before the test on a grid of delays, and interpolated in between. The row
    of an axis is taken at that axis's delay.

    Parameters
    ----------
    knowledge : Knowledge
        Its options give the first delay and the bounds.
    memory, gains
        The method, see `DelayFilter`.

    Raises
    ------
    InputError
        If parameters of the estimate are invalid.
    """

    def __init__(
        self, knowledge: Knowledge, memory: Memory, gains: Callable[[float], Floats]
    ) -> None:
        self._first, last = knowledge.delay_range
        self._estimator = DelayEstimator(knowledge)
        count = 1 + whole_steps(last - self._first, _GRID * knowledge.dt)
        self._spacing = (last - self._first) / (count - 1)
        grid = self._first + self._spacing * np.arange(count)
        self._table = np.array([gains(float(delay)) for delay in grid])
        self._step = 0
        super().__init__(memory)

    def reset(self) -> None:
        """Forget the test so far, and the estimated delay."""
        self._estimator.reset()
        self._step = 0
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
        index = np.clip(position.astype(int), 0, len(self._table) - 2)
        axes, part = np.arange(len(index)), (position - index)[:, np.newaxis]
        table = self._table
        gains: Floats = (1 - part) * table[index, axes] + part * table[index + 1, axes]
        return gains


WINDOW = 1.0
"""Moving window of the least squares, s."""
_BLOCKS = 20  # the window moves on by one at a time
_FITTED = 0.006  # s: past through which a parabola gives the derivatives; more: less noise
_AMPLITUDE = (0.7, 1.3)  # bounds of a0
_AMPLITUDE_RATE = 0.5  # largest change of a0, 1/s
_PRIOR = 1e-3  # weight of the present coefficients, over that of the data


class Ats(AdaptiveCompensator):
    """f_r = a0 f* + a1 f*' + a2 f*'', with a0, a1, a2 fitted on line to the actuator.

    Adaptive time series compensator (Chae, Kazemibidokhti & Ricles 2013, Earthquake Eng. Struct.
    Dyn. 42:1697-1715): by least squares over a moving window of one second, the reference force
    is a0 f + a1 f' + a2 f'' of the measured force; so an actuator of amplitude A and delay tau
    has a0 = 1 / A, a1 = tau / A, a2 = tau^2 / 2 A, and with these coefficients it follows f*.

    f* = -M_e a_g + S r, S = M_c (M_e + M_c)^-1, is the reference force of the solved loop, see
    `restoring`: the series of the acceleration feedback would grow without limit with frequency.
    Derivatives are those of a parabola through the last 6 ms. The same filter is used for f* and,
    in the fit, for the measured force, so that the coefficients also correct its lag.

    Parameters
    ----------
    knowledge : Knowledge
        Its options give the first delay and the bounds.

    Raises
    ------
    InputError
        If no delay is given, or parameters of the adaptation are invalid.
    """

    def __init__(self, knowledge: Knowledge) -> None:
        n, dt, options = knowledge.axes, knowledge.dt, knowledge.options
        delay, (shortest, longest) = knowledge.delay, knowledge.delay_range
        low, high = _AMPLITUDE
        self._start = np.tile([1.0, delay, delay**2 / 2], (n, 1))
        self._least = np.array([low, low * shortest, 0.0])
        self._greatest = high * np.array([1.0, longest, longest**2 / 2])
        self._coefficients = self._start.copy()
        block, past = whole_steps(WINDOW / _BLOCKS, dt), max(3, round(_FITTED / dt))
        rate = options["compensation.delay_rate"]
        self._most = np.array([_AMPLITUDE_RATE, rate, rate * longest]) * block * dt
        self._enough = options["compensation.excitation"] ** 2 * block * _BLOCKS
        self._forces = ForceBlocks(options["compensation.band"], dt, n, past, block)
        self._derivatives = parabola_weights(1 + past, dt)
        signals = Signals(knowledge, preview=0, blocks=past)
        ground = knowledge.mass @ signals.ground_motion(0.0)
        wanted = knowledge.share @ signals.restoring_force - ground
        values = np.array([wanted, *(signals.state(i) for i in range(past))])
        self._series = np.tensordot(self._derivatives, values, axes=1)  # of f*: (3, n, columns)
        self._sums: deque[Floats] = deque(maxlen=_BLOCKS)
        super().__init__(Memory.past(wanted[:, past * n :], past))

    def reset(self) -> None:
        """Forget the test so far, and the identified values."""
        self._coefficients[:] = self._start
        self._forces.reset()
        self._sums.clear()
        super().reset()

    def estimates(self) -> dict[str, Floats]:
        """Delay a1 / a0 (s) and amplitude 1 / a0 of each axis, as ``delay`` and ``amplitude``."""
        a0, a1, _ = self._coefficients.T
        return {"delay": a1 / a0, "amplitude": 1 / a0}

    def _present_gains(self) -> Floats:
        gains: Floats = np.einsum("ni,inc->nc", self._coefficients, self._series)
        return gains

    def _products(self, reference: Floats, measured: Floats) -> Floats:
        """Sum the products of (f, f', f'', f_r) over a block, for each axis; shape (n, 4, 4)."""
        count = self._derivatives.shape[1]
        latest = sliding_window_view(measured, count, axis=0)[..., ::-1]
        series = np.einsum("ij,snj->isn", self._derivatives, latest)
        rows = np.concatenate([series, reference[np.newaxis, count - 1 :]])
        products: Floats = np.einsum("isn,jsn->nij", rows, rows)
        return products

    def _adapt(self, reference: Floats, measured: Floats) -> bool:
        """Move the coefficients towards those that fit the window."""
        block = self._forces.step(reference, measured)
        if block is None:
            return False
        self._sums.append(self._products(block[:, 0], block[:, 1]))
        for now, total in zip(self._coefficients, np.sum(self._sums, axis=0), strict=True):
            products, wanted = total[:3, :3], total[:3, 3]
            if not self._enough < min(total[0, 0], total[3, 3]) < math.inf:
                continue
            # one frequency alone can't determine three coefficients: the others do not change
            prior = np.diag(_PRIOR * np.diag(products))
            found = np.linalg.solve(products + prior, wanted + prior @ now)
            bounded = np.clip(found, now - self._most, now + self._most)
            now[:] = np.clip(bounded, self._least, self._greatest)
        return True


def parabola_weights(count: int, dt: float) -> Floats:
    """Weights of the last values, newest first, for value and derivatives now.

    They are those of a parabola fitted by least squares: the filter of Savitzky & Golay (1964) at
    the end of its window.

    Returns
    -------
    ndarray
        Shape (3, count): of the value, the first and the second derivative.
    """
    times = -dt * np.arange(count)
    fit = np.linalg.pinv(np.vander(times / dt, 3, increasing=True))
    weights: Floats = fit * np.array([[1.0], [1.0 / dt], [2.0 / dt**2]])
    return weights
