"""Limits of a test, checked on every sample."""

from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.parameters import Parameter

Floats = npt.NDArray[np.float64]

NAMES = ("displacement", "velocity", "acceleration", "force")
UNITS = ("m", "m/s", "m/s^2", "N")
_DEFAULTS = (0.076, 0.5, 98.1, 22200.0)


def limit_rows(default_from: str = "") -> list[Parameter]:
    """Rows ``limits.*`` of a parameter table; defaults suit the paper's rig.

    Parameters
    ----------
    default_from : str
        Node whose limits stand in where these are not given.
    """
    return [
        Parameter(
            f"limits.{name}",
            "float",
            default,
            f"largest {name} on any axis; beyond it the test trips",
            unit,
            positive=True,
            default_from=f"{default_from}:limits.{name}" if default_from else "",
        )
        for name, unit, default in zip(NAMES, UNITS, _DEFAULTS, strict=True)
    ] + [
        Parameter(
            "limits.saturated_time",
            "float",
            0.05,
            "longest time within one second that sensors may be at the end of their range; "
            "a test that is blind for longer trips",
            "s",
            minimum=0.0,
            default_from=f"{default_from}:limits.saturated_time" if default_from else "",
        )
    ]


class Limits:
    """Largest magnitudes of a sample.

    Parameters
    ----------
    limits : dict
        ``displacement`` (m), ``velocity`` (m/s), ``acceleration`` (m/s^2), ``force`` (N).
    axes : sequence of str
        Names of the n axes.
    """

    def __init__(self, limits: dict[str, Any], axes: Sequence[str]) -> None:
        self._axes = tuple(axes)
        self._limits = np.array([[limits[name]] for name in NAMES], dtype=np.float64)
        self._scale = np.repeat(1.0 / self._limits, len(self._axes), axis=1)
        self._scaled = np.zeros_like(self._scale)
        self._flat = self._scaled.ravel()  # a view

    def violation(self, state: Floats) -> str | None:
        """Say which limit a measured state breaks, if any; NaN breaks every limit.

        Parameters
        ----------
        state : ndarray
            Displacement, velocity, acceleration and force, shape (4, n).

        Returns
        -------
        str or None
            One line with limit, value and axis.
        """
        np.multiply(state, self._scale, self._scaled)
        if self._flat.dot(self._flat) < 0.99:  # well inside the ellipsoid, and so inside the box
            return None
        within = np.abs(state) <= self._limits
        if within.all():
            return None
        row, column = np.argwhere(~within)[0]
        name, unit, limit = NAMES[row], UNITS[row], self._limits[row, 0]
        return (
            f"{name} {state[row, column]:.5g} {unit} on axis {self._axes[column]} "
            f"is beyond the limit of {limit:g} {unit}"
        )


class SaturatedTime:
    """How long sensors have been at the end of their range within the last second.

    Parameters
    ----------
    longest : float
        Time beyond which it is a violation, s.
    dt : float
        Sampling period, s.
    """

    def __init__(self, longest: float, dt: float) -> None:
        self._longest = longest
        self._allowed = int(longest / dt * (1 + 1e-9))
        self._window = round(1.0 / dt)
        self._steps: deque[int] = deque()

    def reset(self) -> None:
        """Forget the test so far."""
        self._steps.clear()

    def violation(self, step: int, sensors: Sequence[str]) -> str | None:
        """Say whether sensors have been blind for too long.

        Parameters
        ----------
        step : int
            Step of the sample.
        sensors : sequence of str
            Which are at the end of their range, one at least.

        Returns
        -------
        str or None
            One line with the sensors and the time.
        """
        steps = self._steps
        steps.append(step)
        while steps[0] <= step - self._window:
            steps.popleft()
        if len(steps) <= self._allowed:
            return None
        names = " and ".join(sorted(set(sensors))).replace("_range", "")
        return (
            f"{names} at the end of the sensor's range for more than {self._longest:g} s within "
            "one second: the test is blind"
        )
