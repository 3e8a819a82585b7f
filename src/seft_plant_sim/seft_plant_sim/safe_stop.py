"""How a rig is brought to rest when a test trips."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.arrays import per_axis

AT_REST = 1e-4  # m/s
RESTS = 10  # steps below that, so that a vibration's turning point is no rest


@dataclass(frozen=True)
class Safe:
    """The safe position of the valves.

    Attributes
    ----------
    command : ndarray
        Valve command, shape (n,), V.
    longest : int
        Steps for which the rig is followed to rest.
    """

    command: npt.NDArray[np.float64]
    longest: int

    @classmethod
    def from_parameters(cls, group: dict[str, Any], axes: Sequence[str], dt: float) -> "Safe":
        """Make it of the parameters ``safe.*``; InputError if sizes do not fit the axes."""
        command = per_axis(group["valve_command"], axes, "rig: safe.valve_command")
        return cls(command, round(group["settle_time"] / dt))

    def part(self, places: Sequence[int]) -> "Safe":
        """Take the valves at some places among the axes."""
        return replace(self, command=self.command[list(places)])


@dataclass(frozen=True)
class Stopped:
    """How a rig came to rest.

    Attributes
    ----------
    steps : int
        Steps until it rested, or until nobody looked any more.
    peak_force : float
        Largest force of any actuator meanwhile, N.
    """

    steps: int
    peak_force: float
