"""What a laboratory writes: its data acquisition and its servo amplifier, in volts."""

from typing import Protocol

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


class Hardware(Protocol):
    """Inputs and outputs of a rig of n axes.

    All calls come from one thread, in real time: they must not wait for anything but the
    converters.
    """

    def read_sample(self) -> Floats:
        """Read all channels at one instant.

        Returns
        -------
        ndarray
            Displacement, velocity, acceleration and force of each axis in V, shape (4, n), as
            the amplifiers give them: `Volts` makes SI units of them.
        """

    def write_command(self, volts: Floats) -> None:
        """Put out the valve commands, V, shape (n,); positive extends the actuator."""

    def to_safe_command(self) -> None:
        """Bring the rig to rest without the loop, and keep it there until the next command.

        Called once in every trip, at every end of a test and when the node ends; also several
        times in a row. It must work whatever state the rig is in.
        """

    # A rig that can take the pressure away may have dump_pressure(self), too: called where a piston
    # goes on after its valve was closed.

    def close(self) -> None:
        """Give the devices back."""
