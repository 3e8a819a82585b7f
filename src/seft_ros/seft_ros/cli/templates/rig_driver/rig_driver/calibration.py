"""Volts of the amplifiers <-> SI units."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.config.parameter_table import parameter_rows, per_axis

Floats = npt.NDArray[np.float64]

CHANNELS = ("position", "velocity", "acceleration", "force")
PARAMETERS = parameter_rows(
    """
    position_factor     | floats |     | m/V       |  |
        displacement per volt, positive where the actuator extends; the factor is negative where
        the sensor stands the other way round
    velocity_factor     | floats |     | (m/s)/V   |  | velocity per volt, likewise
    acceleration_factor | floats |     | (m/s^2)/V |  | the specimen's acceleration, likewise
    force_factor        | floats |     | N/V       |  |
        force of the actuator on the specimen per volt, positive where it pushes that way
    position_offset     | floats | 0.0 | V         |  | volts at zero position
    velocity_offset     | floats | 0.0 | V         |  | volts at zero velocity
    acceleration_offset | floats | 0.0 | V         |  | volts at zero acceleration
    force_offset        | floats | 0.0 | V         |  | volts at zero force
    resolution          | float  | 0.0 | V         | 0 .. |
        step of the converter; 0: finer than the noise
    """,
    "calibration",
)


class Calibration:
    """Factors and offsets of the sensors, of the parameters ``calibration.*``.

    Parameters
    ----------
    group : dict
        The parameters; InputError if their sizes do not fit the axes.
    axes : sequence of str
        Names of the n axes.

    Attributes
    ----------
    factors : ndarray
        SI units per volt, shape (4, n).
    offsets : ndarray
        Volts at zero, shape (4, n).
    resolution : ndarray
        Step of the converter in SI units, shape (4, n).
    """

    def __init__(self, group: dict[str, Any], axes: Sequence[str]) -> None:
        def rows(kind: str) -> Floats:
            names = [f"{channel}_{kind}" for channel in CHANNELS]
            return np.array([per_axis(group[n], axes, f"rig: calibration.{n}") for n in names])

        self.factors, self.offsets = rows("factor"), rows("offset")
        self.resolution = np.abs(self.factors) * group["resolution"]

    def to_si(self, volts: Floats) -> Floats:
        """Give displacement (m), velocity (m/s), acceleration (m/s^2) and force (N), (4, n)."""
        si: Floats = (volts - self.offsets) * self.factors
        return si
