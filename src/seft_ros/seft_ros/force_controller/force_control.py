"""The one shape of all force controllers, and what they are made of."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class ControlKnowledge:
    """What a controller knows of the test.

    Attributes
    ----------
    axes : int
        Number of axes n.
    dt : float
        Sampling period, s.
    voltage_limit : float
        Largest valve drive, either way, V; what is beyond is cut off.
    """

    axes: int
    dt: float
    voltage_limit: float


@dataclass(frozen=True)
class LinearControl:
    """A controller as a linear system with states w, p of them, over n axes.

    Its input s is the reference force, then the measured displacement, velocity, acceleration
    and force: 5 n values. u = c w + d s, w[k+1] = a w + b s.

    Attributes
    ----------
    a, b, c, d : ndarray
        Shapes (p, p), (p, 5n), (n, p) and (n, 5n).
    """

    a: Floats
    b: Floats
    c: Floats
    d: Floats

    @classmethod
    def of_error(
        cls, a: Floats, b: Floats, c: Floats, d: Floats, feedback: bool = True
    ) -> "LinearControl":
        """Make one that sees the force error f_r - f alone; without feedback, f_r alone.

        Parameters
        ----------
        a, b, c, d : ndarray
            Shapes (p, p), (p, n), (n, p) and (n, n).
        feedback : bool
            Whether the measured force is fed back.
        """
        error = np.eye(len(d), 5 * len(d))
        if feedback:
            error -= np.eye(len(d), 5 * len(d), k=4 * len(d))
        return cls(a, b @ error, c, d @ error)

    @classmethod
    def none(cls, axes: int) -> "LinearControl":
        """Make one that hands the reference force itself on."""
        one = np.eye(axes)
        return cls.of_error(np.zeros((0, 0)), one[:0], one[:, :0], one, feedback=False)


class ForceControl(Protocol):
    """What the loop asks of a force controller.

    One that identifies may have ``estimates()`` beside: each quantity by name, shape (n,). The
    node tells them in its diagnostics.

    Attributes
    ----------
    limited : bool
        Whether the last drive was at its limit on any axis.
    shape : tuple of int
        How many points it needs, and quantities of each: 1, the force, or 3, of a target.
    """

    limited: bool
    shape: tuple[int, int]

    def reset(self) -> None:
        """Forget the test so far."""

    def step(self, points: Floats, state: Floats) -> Floats:
        """Compute the valve drive of one step.

        Parameters
        ----------
        points : ndarray
            What is asked for at this step and coming ones, shape (p, q, n): the last quantity is
            the reference force, N; of a target, displacement and velocity stand before it.
        state : ndarray
            Measured displacement (m), velocity (m/s), acceleration (m/s^2) and force (N),
            shape (4, n).

        Returns
        -------
        ndarray
            Valve drive within the limit, shape (n,), V.
        """

    def linear(self) -> LinearControl:
        """Linear system that it is as long as no limit is met.

        Raises
        ------
        InputError
            If it does not say.
        """
