"""Limits of a test, checked on every sample, and how near it came to them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.parameters import Parameter

Floats = npt.NDArray[np.float64]

NAMES = ("displacement", "velocity", "acceleration", "force")
UNITS = ("m", "m/s", "m/s^2", "N")
RATE_UNITS = ("m/s", "m/s^2", "m/s^3", "N/s")
_DEFAULTS = (0.076, 0.5, 98.1, 22200.0)
_RATE_DEFAULTS = (3.0, 300.0, 3e4, 3e6)
"""Of one sample to the next. Tests of config/jhu.yaml and config/demo.yaml that go well reach
0.48, 26, 3e3 and 1.4e5; with valve and accelerometer driven into saturation 0.48, 51, 1.5e4 and
6.5e5. An accelerometer's full range of 4 g at the oil column's 90 Hz is 2.2e4."""
ROWS = (*NAMES, *(f"{name}_rate" for name in NAMES))
_ALL_UNITS = (*UNITS, *RATE_UNITS)


def limit_rows(default_from: str = "") -> list[Parameter]:
    """Rows ``limits.*`` of a parameter table; defaults suit the paper's rig.

    Parameters
    ----------
    default_from : str
        Node whose limits stand in where these are not given.
    """
    texts = [f"largest {name} on any axis; beyond it the test trips" for name in NAMES] + [
        f"largest change of the measured {name} from one sample to the next, per second; beyond "
        "it, as when a sensor or its cable breaks, the test trips"
        for name in NAMES
    ]
    rows = [
        Parameter(f"limits.{name}", "float", default, text, unit, positive=True)
        for name, unit, default, text in zip(
            ROWS, _ALL_UNITS, (*_DEFAULTS, *_RATE_DEFAULTS), texts, strict=True
        )
    ]
    rows.append(
        Parameter(
            "limits.saturated_time",
            "float",
            0.05,
            "longest time within one second that sensors may be at the end of their range; "
            "a test that is blind for longer trips",
            "s",
            minimum=0.0,
        )
    )
    if not default_from:
        return rows
    return [replace(row, default_from=f"{default_from}:{row.name}") for row in rows]


class Limits:
    """Largest magnitudes of a sample, and of its change since the sample before.

    Parameters
    ----------
    limits : dict
        ``displacement`` (m), ``velocity`` (m/s), ``acceleration`` (m/s^2), ``force`` (N), and
        the same names with ``_rate`` (per second), which may lack.
    axes : sequence of str
        Names of the n axes.
    dt : float
        Sampling period, s.

    Attributes
    ----------
    limits : ndarray
        Shape (8, 1): of the state, and of its change in a step.
    """

    def __init__(self, limits: Mapping[str, Any], axes: Sequence[str], dt: float) -> None:
        self._axes = tuple(axes)
        self._dt = dt
        values = [limits[name] for name in NAMES]
        values += [limits.get(f"{name}_rate", np.inf) * dt for name in NAMES]
        self.limits = np.array(values, dtype=np.float64)[:, np.newaxis]
        self._scale = np.repeat(1.0 / self.limits, len(self._axes), axis=1)
        self._work = np.zeros_like(self._scale)
        self._state, self._change = self._work[:4], self._work[4:]  # views
        self._scaled = np.zeros_like(self._scale)
        self._flat = self._scaled.ravel()  # a view
        self._largest = np.zeros_like(self._scale)
        self._is_first = True

    def reset(self) -> None:
        """Forget the test so far: the next sample has none before it."""
        self._is_first = True
        self._largest[:] = 0.0

    def violation(self, state: Floats) -> str | None:
        """Say which limit the next measured state breaks, if any; NaN breaks every limit.

        Parameters
        ----------
        state : ndarray
            Displacement, velocity, acceleration and force, shape (4, n).

        Returns
        -------
        str or None
            One line with limit, value and axis.
        """
        if self._is_first:
            self._is_first = False
            self._change[:] = 0.0
        else:
            np.subtract(state, self._state, self._change)
        self._state[:] = state
        np.multiply(self._work, self._scale, self._scaled)
        if self._flat.dot(self._flat) < 0.99:  # well inside the ellipsoid, and so inside the box
            return None
        within = np.abs(self._work) <= self.limits
        if within.all():
            return None
        row, column = np.argwhere(~within)[0]
        per = self._dt if row >= len(NAMES) else 1.0
        name, unit = ROWS[row].replace("_", " "), _ALL_UNITS[row]
        return (
            f"{name} {self._work[row, column] / per:.5g} {unit} on axis {self._axes[column]} "
            f"is beyond the limit of {self.limits[row, 0] / per:g} {unit}"
        )

    def note_margins(self) -> None:
        """Take the last sample into `margins`; the loop offline, in a hurry, does without."""
        np.fmax(self._largest, np.abs(self._scaled), self._largest)

    def margins(self) -> dict[str, float]:
        """Smallest distance to each limit since the reset, over the limit; 0 and below: broken."""
        return dict(zip(ROWS, (1.0 - self._largest.max(axis=1)).tolist(), strict=True))
