"""Your data acquisition and servo amplifier; here a simulated converter board."""

import numpy as np
from seft_plant_sim.simulated.rig import ConverterBoard


class Hardware:
    """What the node rig hosts: all calls come from one thread, and take less than a period.

    It is made with the parameters of the rig, by name, and the names of its n axes.
    """

    def __init__(self, parameters, axes):
        self._closed = np.zeros(len(axes))  # V, at which the piston stands
        self._board = ConverterBoard(parameters, axes)  # put your own here

    def read(self):
        """Read displacement, velocity, acceleration and force at one instant, V, shape (4, n)."""
        return self._board.inputs()

    def write(self, drive):
        """Put out the valve commands, V, shape (n,); positive extends the actuator."""
        self._board.output(drive)

    def safe(self):
        """Bring the rig to rest, whatever it is in, until the next `write`."""
        self._board.output(self._closed)

    def close(self):
        """Give the devices back."""
