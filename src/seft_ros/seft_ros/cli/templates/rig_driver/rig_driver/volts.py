"""Volts of the amplifiers <-> SI units."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.config.facts import CHANNELS
from seft_msgs_py.config.parameter_table import parameter_rows, per_axis

Floats = npt.NDArray[np.float64]

PARAMETERS = parameter_rows(
    """
    displacement_factor | floats |     | m/V       |  |
        displacement per volt, positive where the actuator extends; the factor is negative where
        the sensor stands the other way round
    velocity_factor     | floats |     | (m/s)/V   |  | velocity per volt, likewise
    acceleration_factor | floats |     | (m/s^2)/V |  | the specimen's acceleration, likewise
    force_factor        | floats |     | N/V       |  |
        force of the actuator on the specimen per volt, positive where it pushes that way
    displacement_bias   | floats | 0.0 | V         |  | volts at a true value of 0
    velocity_bias       | floats | 0.0 | V         |  | likewise
    acceleration_bias   | floats | 0.0 | V         |  | likewise
    force_bias          | floats | 0.0 | V         |  | likewise, without load
    resolution          | float  | 0.0 | V         | 0 .. |
        step of the converter; 0: finer than the noise
    """,
    "volts",
)


class Volts:
    """Factors and biases of the sensors, of the parameters ``volts.*``.

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
    biases : ndarray
        Volts at a true value of 0, shape (4, n).
    resolution : ndarray
        Step of the converter in SI units, shape (4, n).
    """

    def __init__(self, group: dict[str, Any], axes: Sequence[str]) -> None:
        def rows(kind: str) -> Floats:
            names = [f"{channel}_{kind}" for channel in CHANNELS]
            return np.array([per_axis(group[n], axes, f"rig: volts.{n}") for n in names])

        self.factors, self.biases = rows("factor"), rows("bias")
        self.resolution = np.abs(self.factors) * group["resolution"]

    def to_si(self, volts: Floats) -> Floats:
        """Give displacement (m), velocity (m/s), acceleration (m/s^2) and force (N), (4, n)."""
        si: Floats = (volts - self.biases) * self.factors
        return si
