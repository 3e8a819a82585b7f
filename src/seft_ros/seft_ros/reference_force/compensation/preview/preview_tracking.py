"""Preview tracking: the force to ask for so that the measured force meets its coming target."""

from dataclasses import dataclass
from functools import lru_cache
from math import comb

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_discrete_are

from seft_ros.reference_force.compensation.preview.tracking_model import TrackingModel

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class PreviewTracking:
    """Non-causal inverse of a force loop, optimal over a horizon.

    u[k] = state z[k] + past (u[k-1], u[k-2], ...) + sum_j target[j] w[k+j] minimises the sum of
    (f - w)^2 + rho (d^q u)^2, d^q the q-th difference (LQ preview control: Tomizuka 1975;
    Katayama et al. 1985). rho sets the corner up to which the target is followed; beyond the
    horizon the target is taken to stay.

    Attributes
    ----------
    state : ndarray
        Gains of the tracking model's states, shape (s,).
    past : ndarray
        Gains of the last q forces, the newest first, shape (q,).
    target : ndarray
        Gains of the target from this step on, shape (1 + horizon,).
    """

    state: Floats
    past: Floats
    target: Floats

    @classmethod
    @lru_cache(maxsize=8)
    def design(
        cls, model: TrackingModel, horizon: int, corner: float, order: int = 4
    ) -> "PreviewTracking":
        """Solve for the gains; those of the same model are at hand.

        Parameters
        ----------
        model : TrackingModel
            The force loop.
        horizon : int
            Steps of the target that are known ahead.
        corner : float
            Frequency up to which the target is followed, over the sampling frequency.
        order : int
            q, how sharply following ends there.
        """
        size, rho = len(model.a), (2 * np.sin(np.pi * corner)) ** (-2 * order)
        hold = np.zeros(size + order)  # u = hold (z, past) + d^q u
        hold[size:] = [-((-1) ** i) * comb(order, i) for i in range(1, order + 1)]
        a = np.zeros((size + order, size + order))
        a[:size, :size] = model.a
        a[:size] += np.outer(model.b, hold)
        a[size] = hold
        a[size + 1 :, size:-1] = np.eye(order - 1)
        b = np.concatenate([model.b, np.eye(1, order)[0]])[:, np.newaxis]
        c = np.concatenate([model.c, np.zeros(order)])
        cost = np.outer(c, c) + 1e-12 * np.eye(size + order)
        riccati = solve_discrete_are(a, b, cost, np.array([[rho]]))
        scale = 1.0 / (rho + b[:, 0] @ riccati @ b[:, 0])
        feedback = scale * (b[:, 0] @ riccati @ a)
        closed = (a - np.outer(b[:, 0], feedback)).T
        target, ahead = np.zeros(horizon + 1), c
        for j in range(1, horizon + 1):
            target[j] = scale * (b[:, 0] @ ahead)
            ahead = closed @ ahead
        rest = np.linalg.solve(np.eye(size + order) - closed, ahead)
        target[horizon] += scale * (b[:, 0] @ rest)
        gains = hold - feedback
        return cls(gains[:size], gains[size:], target)
