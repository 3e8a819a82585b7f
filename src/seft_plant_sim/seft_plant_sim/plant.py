"""Sampling of a continuous model whose drive is held between samples."""

from typing import Protocol

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm

from seft_plant_sim.continuous_model import ContinuousModel
from seft_plant_sim.dead_time import DeadTime
from seft_plant_sim.nonlinear_plant import NonlinearPlant

Floats = npt.NDArray[np.float64]


class Plant(Protocol):
    """Actuator and specimen between samples.

    The command given to `step` is applied from the new sample on; displacement and velocity
    follow from what was applied before. Where the model answers its drive without delay (the
    ideal actuator), the new sample holds that answer already.
    """

    def reset(self) -> Floats:
        """Bring it to rest with no drive; return the sample there, shape (4, n)."""

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

    def saturated(self) -> list[str]:
        """Name what is at the end of its range at the last sample."""


def make_plant(model: ContinuousModel, dt: float) -> Plant:
    """Plant of a model at a sampling period of ``dt`` seconds."""
    return LinearPlant(model, dt) if model.nonlinearity is None else NonlinearPlant(model, dt)


class LinearPlant:
    """Linear `Plant`: zero-order hold, exact for any dead time.

    Parameters
    ----------
    model : ContinuousModel
        n axes; a nonlinearity is left out.
    dt : float
        Sampling period, s.

    Attributes
    ----------
    dead_time : DeadTime
        Of the drive.
    matrix : ndarray
        Shape (s + 4n, s + 3n): takes (z, drive before and after its change between the samples,
        drive at the new sample) to (z, outputs) at the new sample.
    """

    def __init__(self, model: ContinuousModel, dt: float) -> None:
        self._axes = model.b.shape[1]
        self._size = len(model.a)
        self.dead_time = DeadTime(model.delay, dt, self._axes)
        self.matrix = self._transition(model, dt)
        self._work = np.zeros(self.matrix.shape[1])
        self._state = self._work[: self._size]
        self._before, self._after, self._now = self._work[self._size :].reshape(3, self._axes)
        self._answers_at_once = bool(model.d.any())
        self.reset()

    def reset(self) -> Floats:
        """Bring it to rest with no drive; return the sample there, shape (4, n)."""
        self._work[:] = 0.0
        self.dead_time.reset()
        return np.zeros((4, self._axes))

    def step(self, command: Floats) -> Floats:
        """Advance by one sample, see `Plant.step`."""
        before, after, now = self.dead_time.step(command)
        self._before[:] = before
        self._after[:] = after
        if self._answers_at_once:
            self._now[:] = now
        result = self.matrix.dot(self._work)
        self._state[:] = result[: self._size]
        return result[self._size :].reshape(4, self._axes)

    def saturated(self) -> list[str]:
        """Nothing: a linear model has no end."""
        return []

    def _transition(self, model: ContinuousModel, dt: float) -> Floats:
        """Matrix from one sample to the next.

        It takes (z, drive before and after its change between the samples, drive at the new
        sample) to (z, outputs) at the new sample.
        """
        part = self.dead_time.part
        free_held, forced_held = _zero_order_hold(model, dt - part)
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
