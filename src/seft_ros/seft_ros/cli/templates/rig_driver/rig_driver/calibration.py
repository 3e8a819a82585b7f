"""Volts of the amplifiers <-> SI units."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.config.parameter_table import Parameter, per_axis

Floats = npt.NDArray[np.float64]

CHANNELS = (
    ("position", "m", "displacement, positive where the actuator extends"),
    ("velocity", "m/s", "velocity, likewise"),
    ("acceleration", "m/s^2", "acceleration of the specimen, likewise"),
    ("force", "N", "force of the actuator on the specimen, positive where it pushes that way"),
)
PARAMETERS = (
    *(
        Parameter(
            f"calibration.{name}_factor",
            "floats",
            None,
            f"{text}, per volt; negative where the sensor stands the other way round",
            f"({unit})/V",
        )
        for name, unit, text in CHANNELS
    ),
    *(
        Parameter(f"calibration.{name}_offset", "floats", 0.0, f"volts at zero {name}", "V")
        for name, _, _ in CHANNELS
    ),
)


class Calibration:
    """Factors and offsets of the sensors.

    Parameters
    ----------
    factors : ndarray
        SI units per volt, shape (4, n).
    offsets : ndarray
        Volts at zero, shape (4, n).
    """

    def __init__(self, factors: Floats, offsets: Floats) -> None:
        self.factors, self.offsets = factors, offsets

    @classmethod
    def from_parameters(cls, group: dict[str, Any], axes: Sequence[str]) -> "Calibration":
        """Make it of the parameters ``calibration.*``; InputError if sizes do not fit the axes."""
        rows = [
            [
                per_axis(group[f"{n}_{kind}"], axes, f"rig: calibration.{n}_{kind}")
                for n, *_ in CHANNELS
            ]
            for kind in ("factor", "offset")
        ]
        return cls(np.array(rows[0]), np.array(rows[1]))

    def to_si(self, volts: Floats) -> Floats:
        """Give displacement (m), velocity (m/s), acceleration (m/s^2) and force (N), (4, n)."""
        si: Floats = (volts - self.offsets) * self.factors
        return si
