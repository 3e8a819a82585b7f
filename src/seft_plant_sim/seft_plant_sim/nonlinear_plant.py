"""Integration of a model that is not linear, between samples."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm
from seft_msgs_py.errors import InputError

from seft_plant_sim.continuous_model import ContinuousModel
from seft_plant_sim.dead_time import DeadTime
from seft_plant_sim.nonlinearity import Nonlinearity, Part, Springs

Floats = npt.NDArray[np.float64]

LONGEST_STEP = 5e-4  # s
STEP_TIMES_RATE = 0.5  # of the fastest residual
MAX_STEPS = 500


class NonlinearPlant:
    """`Plant` of a model with a nonlinearity.

    z' = a z + b w + g r(z) is integrated with the exponential Runge-Kutta scheme ETD2RK (Cox &
    Matthews 2002, Eq. 22) in equal steps: the linear part, which holds the fast oil column and
    the valve, is solved exactly, and without residuals this is `LinearPlant`.

    Parameters
    ----------
    model : ContinuousModel
        n axes, with a nonlinearity.
    dt : float
        Sampling period, s.

    Attributes
    ----------
    dead_time : DeadTime
        Of the drive.
    before, after : Stretch
        From the last sample to the drive's change, and from there to the new sample.
    output : ndarray
        Shape (4n, s + n + r): takes (z, drive, residuals) to the outputs.
    parts : tuple of Part
        What makes the residuals, in order.
    drive_limit : ndarray
        Drive beyond which the actuator takes no notice, shape (n,).

    Raises
    ------
    InputError
        If a residual is too fast to be followed.
    """

    def __init__(self, model: ContinuousModel, dt: float) -> None:
        assert model.nonlinearity is not None
        nonlinearity = model.nonlinearity
        parts = nonlinearity.parts
        self.parts: tuple[Part, ...] = parts
        self._residuals = parts[0].residuals if len(parts) == 1 else self._all_residuals
        self._springs = [part for part in parts if isinstance(part, Springs)]
        self._axes = model.b.shape[1]
        self.drive_limit = np.broadcast_to(nonlinearity.drive_limit, (self._axes,))
        self._least_drive = -self.drive_limit
        size, residuals = len(model.a), nonlinearity.inputs.shape[1]
        self.dead_time = DeadTime(model.delay, dt, self._axes)
        part = self.dead_time.part
        self.before = Stretch.of(model, nonlinearity, part)
        self.after = Stretch.of(model, nonlinearity, dt - part)
        self.output = np.hstack([model.c, model.d, nonlinearity.outputs])
        self._work = np.zeros(size + self._axes + residuals)  # z, drive, residuals
        self._state = self._work[:size]
        self._predicted = np.zeros(size)
        self._drive = self._work[size : size + self._axes]
        self._residual = self._work[size + self._axes :]
        self.reset()

    def reset(self) -> Floats:
        """Bring it to rest with no drive; return the sample there, shape (4, n)."""
        self._work[:] = 0.0
        self.dead_time.reset()
        return np.zeros((4, self._axes))

    def step(self, command: Floats) -> Floats:
        """Advance by one sample, see `Plant.step`."""
        command = np.minimum(np.maximum(command, self._least_drive), self.drive_limit)
        before, after, now = self.dead_time.step(command)
        self._integrate(self.before, before)
        self._integrate(self.after, after)
        self._drive[:] = now
        return self.output.dot(self._work).reshape(4, self._axes)

    def saturated(self) -> list[str]:
        """Name what is at the end of its range at the last sample."""
        z = self._state.tolist()
        return [name for part in self.parts for name in part.saturated(z)]

    def _integrate(self, stretch: "Stretch", drive: Floats) -> None:
        work, state, residual, predicted = self._work, self._state, self._residual, self._predicted
        residuals, all_springs = self._residuals, self._springs
        predict, correct = stretch.predict.dot, stretch.correct.dot
        self._drive[:] = drive
        for _ in range(stretch.steps):
            predict(work, predicted)
            change = np.array(residuals(predicted.tolist()))
            change -= residual
            correct(change, state)
            state += predicted
            z = state.tolist()
            for springs in all_springs:
                springs.settle(z)
                state[:] = z
            residual[:] = residuals(z)

    def _all_residuals(self, z: list[float]) -> list[float]:
        return [value for part in self.parts for value in part.residuals(z)]


@dataclass(frozen=True)
class Stretch:
    """A time over which the drive does not change, in equal steps.

    Attributes
    ----------
    steps : int
        Their number; 0 where the time is none.
    predict : ndarray
        Shape (s, s + n + r): takes (z, drive, residuals) to the state after one step if the
        residuals stay as they are.
    correct : ndarray
        Shape (s, r): what a change of the residuals in the step adds.
    """

    steps: int
    predict: Floats
    correct: Floats

    @classmethod
    def of(cls, model: ContinuousModel, nonlinearity: Nonlinearity, time: float) -> "Stretch":
        """Make it of a model, for a time in s; InputError if a residual is too fast."""
        fastest = max(part.fastest for part in nonlinearity.parts)
        longest = min(LONGEST_STEP, STEP_TIMES_RATE / fastest) if fastest else LONGEST_STEP
        steps = math.ceil(time / longest * (1 - 1e-9))
        if steps > MAX_STEPS:
            raise InputError(
                f"rig: friction or end stops answer at {fastest:.3g} 1/s, too fast to be "
                "followed; raise actuator.friction_velocity or check mass and oil_stiffness"
            )
        s = len(model.a)
        drives = np.hstack([model.b, nonlinearity.inputs])
        m = drives.shape[1]
        # exponential of the model with drives that are constant (first m) or grow from 0 (last)
        augmented = np.zeros((s + 2 * m, s + 2 * m))
        h = time / max(1, steps)
        augmented[:s, :s] = model.a * h
        augmented[:s, s : s + m] = drives * h
        augmented[s : s + m, s + m :] = np.eye(m)
        exponential = expm(augmented)[:s]
        axes = model.b.shape[1]
        return cls(
            steps,
            np.ascontiguousarray(exponential[:, : s + m]),
            np.ascontiguousarray(exponential[:, s + m + axes :]),
        )
