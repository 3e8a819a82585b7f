"""Exact sampling of a continuous model whose drive is held between samples."""

from collections import deque

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm
from seft_msgs_py.errors import InputError

from seft_plant_sim.actuator import ContinuousModel

Floats = npt.NDArray[np.float64]

MAX_DELAY_STEPS = 1_000_000


class LinearPlant:
    """Actuator and specimen between samples: zero-order hold, exact for any dead time.

    The command given to `step` is applied from the new sample on; displacement and velocity
    follow from what was applied before. Where the model answers its drive without delay (the
    ideal actuator), the new sample holds that answer already.

    Parameters
    ----------
    model : ContinuousModel
        n axes.
    dt : float
        Sampling period, s.
    """

    def __init__(self, model: ContinuousModel, dt: float) -> None:
        self._axes = model.b.shape[1]
        self._size = len(model.a)
        steps = int(model.delay / dt + 1e-9)
        if steps > MAX_DELAY_STEPS:
            raise InputError(f"actuator: a delay of {model.delay:g} s is {steps} samples long")
        rest = model.delay - steps * dt
        self._part = rest if rest > 1e-9 * dt else 0.0
        self._matrix = self._transition(model, dt)
        self._line: deque[Floats] = deque(maxlen=steps + 2)
        self._work = np.zeros(self._matrix.shape[1])
        self._state = self._work[: self._size]
        self._before, self._after, self._now = self._work[self._size :].reshape(3, self._axes)
        self.reset()

    def reset(self) -> Floats:
        """Bring it to rest with no drive; return the sample there, shape (4, n)."""
        self._work[:] = 0.0
        self._line.extend(np.zeros(self._axes) for _ in range(self._line.maxlen or 0))
        return np.zeros((4, self._axes))

    def step(self, command: Floats) -> Floats:
        """Advance by one sample.

        Parameters
        ----------
        command : ndarray
            Drive applied from the new sample on, shape (n,).

        Returns
        -------
        ndarray
            Shape (4, n): displacement (m), velocity (m/s), acceleration (m/s^2), force (N) at
            the new sample.
        """
        line = self._line
        self._before[:] = line[0]
        self._after[:] = line[1]
        line.append(command)  # the oldest falls out
        self._now[:] = line[0] if self._part else line[1]
        result = self._matrix.dot(self._work)
        self._state[:] = result[: self._size]
        return result[self._size :].reshape(4, self._axes)

    def _transition(self, model: ContinuousModel, dt: float) -> Floats:
        """Matrix from one sample to the next.

        It takes (z, drive before and after its change between the samples, drive at the new
        sample) to (z, outputs) at the new sample.
        """
        held, part = dt - self._part, self._part
        free_held, forced_held = _zero_order_hold(model, held)
        free_part, forced_part = _zero_order_hold(model, part)
        state = np.hstack([free_held @ free_part, free_held @ forced_part, forced_held])
        output = np.hstack([model.c @ state, model.d])
        return np.ascontiguousarray(
            np.vstack([np.hstack([state, np.zeros((self._size, self._axes))]), output])
        )


def _zero_order_hold(model: ContinuousModel, time: float) -> tuple[Floats, Floats]:
    """Transition over ``time`` seconds under a constant drive: z(time) = free z + forced w."""
    s, n = model.b.shape
    augmented = np.zeros((s + n, s + n))
    augmented[:s, :s] = model.a * time
    augmented[:s, s:] = model.b * time
    exponential = expm(augmented)
    return exponential[:s, :s], exponential[:s, s:]
