"""Whether a reference force and the measured state behind it can be what they say they are."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

_QUANTITIES = ("displacement", "velocity", "acceleration", "force")


class PlausibleState:
    """A guard: every measured value must be finite.

    Parameters
    ----------
    axes : sequence of str
        Names of the n axes.
    """

    def __init__(self, axes: Sequence[str]) -> None:
        self._axes = tuple(axes)

    def reset(self) -> None:
        """Nothing is remembered."""

    def step(self, ground_motion: Floats, state: Floats) -> str | None:
        """See `Guard.step`."""
        del ground_motion
        flat = state.ravel()
        if math.isfinite(flat.dot(flat)):  # finite squares are of finite values
            return None
        bad = np.argwhere(~np.isfinite(state))
        if not len(bad):
            return None
        row, axis = bad[0]
        return f"measured {_QUANTITIES[row]} is {state[row, axis]} on axis {self._axes[axis]}"


class PlausibleForce:
    """Limits of the reference force: finite, not too large, not changing too fast.

    Parameters
    ----------
    largest : float
        Largest magnitude on any axis, N.
    fastest : float
        Fastest change on any axis, N/s.
    axes : sequence of str
        Names of the n axes.
    dt : float
        Sampling period, s.

    Attributes
    ----------
    last : list of float
        The last force that was plausible; zero before the first.
    largest, most : float
        Largest magnitude, and largest change in a step, N.
    """

    def __init__(self, largest: float, fastest: float, axes: Sequence[str], dt: float) -> None:
        self.largest, self._fastest, self._dt = largest, fastest, dt
        self.most = fastest * dt * (1 + 1e-12)
        self._axes = tuple(axes)
        self.reset()

    def reset(self) -> None:
        """Begin a new test: no force was applied before it."""
        self.last = [0.0] * len(self._axes)

    def fault(self, force: Floats) -> str | None:
        """Say what is wrong with the force of a step, if anything.

        Parameters
        ----------
        force : ndarray
            Shape (n,), N.

        Returns
        -------
        str or None
            One line with limit, value and axis.
        """
        values = force.tolist()
        largest, most = self.largest, self.most
        for value, last in zip(values, self.last, strict=True):
            if not (abs(value) <= largest and abs(value - last) <= most):
                return self._describe(values)
        self.last = values
        return None

    def _describe(self, values: list[float]) -> str:
        for axis, value, last in zip(self._axes, values, self.last, strict=True):
            if not math.isfinite(value):
                return f"reference force is {value} N on axis {axis}"
            if abs(value) > self.largest:
                return (
                    f"reference force {value:.5g} N on axis {axis} is beyond the limit of "
                    f"{self.largest:g} N"
                )
            if abs(value - last) > self.most:
                return (
                    f"reference force changes by {(value - last) / self._dt:.5g} N/s on axis "
                    f"{axis}, beyond the limit of {self._fastest:g} N/s"
                )
        raise ValueError("nothing is wrong with the force")
