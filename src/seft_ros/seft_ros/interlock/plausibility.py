"""Whether a reference force and the measured state behind it can be what they say they are."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from seft_plant_sim.compiled import compiled, entry_point

Floats = npt.NDArray[np.float64]

_QUANTITIES = ("displacement", "velocity", "acceleration", "force")


@compiled
def is_plausible(limits: Floats, last: Floats, force: Floats) -> bool:
    """Say whether a force is finite, not too large, and not changing too fast.

    Parameters
    ----------
    limits : ndarray
        Largest magnitude, and largest change in a step, N, shape (2,).
    last : ndarray
        The last plausible force, shape (n,), N: brought up to date.
    force : ndarray
        Shape (n,), N.
    """
    for i in range(len(last)):
        if not (abs(force[i]) <= limits[0] and abs(force[i] - last[i]) <= limits[1]):
            return False
    for i in range(len(last)):
        last[i] = force[i]
    return True


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
    limits, last : ndarray
        What `is_plausible` takes; the last plausible force is zero before the first.
    axes, dt
        As given.
    """

    def __init__(self, largest: float, fastest: float, axes: Sequence[str], dt: float) -> None:
        self._fastest, self.dt, self.axes = fastest, dt, tuple(axes)
        self.limits = np.array([largest, fastest * dt * (1 + 1e-12)])
        self.last = np.zeros(len(self.axes))
        self._fits = entry_point(is_plausible, self.limits, self.last, self.last)

    def reset(self) -> None:
        """Begin a new test: no force was applied before it."""
        self.last[:] = 0.0

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
        fits = self._fits(self.limits, self.last, np.ascontiguousarray(force))
        return None if fits else self.describe(force)

    def describe(self, force: Floats) -> str:
        """Say what is wrong with a force that is not plausible, shape (n,), after the last one."""
        largest = self.limits[0]
        for axis, value, last in zip(self.axes, force.tolist(), self.last.tolist(), strict=True):
            if not math.isfinite(value):
                return f"reference force is {value} N on axis {axis}"
            if abs(value) > largest:
                return (
                    f"reference force {value:.5g} N on axis {axis} is beyond the limit of "
                    f"{largest:g} N"
                )
            if abs(value - last) > self.limits[1]:
                return (
                    f"reference force changes by {(value - last) / self.dt:.5g} N/s on axis "
                    f"{axis}, beyond the limit of {self._fastest:g} N/s"
                )
        raise ValueError("nothing is wrong with the force")


def not_finite(state: Floats, axes: Sequence[str]) -> str:
    """Say which value of a measured state, shape (4, n), is not finite; empty if all are."""
    bad = np.argwhere(~np.isfinite(state))
    if not len(bad):
        return ""
    row, axis = bad[0]
    return f"measured {_QUANTITIES[row]} is {state[row, axis]} on axis {axes[axis]}"
