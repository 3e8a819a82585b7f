"""A converter board with a simulated rig at its terminals, in place of a laboratory's."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.wire.topics import RigAxes, Timebase

from seft_plant_sim.channels import per_channel
from seft_plant_sim.simulated.rig import SimulatedRig


class ConverterBoard:
    """Shows the volts of a simulated rig's amplifiers, which goes on moving between two tests.

    Parameters
    ----------
    parameters : mapping
        Of the rig, by name: what it truly is, and ``calibration.*_per_volt``.
    axes : tuple of str
        Names of its n axes.
    """

    def __init__(self, parameters: Mapping[str, Any], axes: tuple[str, ...]) -> None:
        section, every = dict(parameters), tuple(parameters["axes"])
        rig = RigAxes("", axes, tuple(every.index(axis) for axis in axes))
        timebase = Timebase.from_rate(section["rate"])
        self._rig = SimulatedRig.from_parameters(section, every, timebase, rig)
        self._rig.reset()
        per_volt = per_channel(section, every, "calibration.{}_per_volt")
        self._per_volt = per_volt[:, list(rig.places)]

    def inputs(self) -> Floats:
        """Convert all channels a period after the last time, V, shape (4, n)."""
        return np.asarray(self._rig.read() / self._per_volt)

    def output(self, volts: Floats) -> None:
        """Put out the valve commands, V, shape (n,)."""
        self._rig.write(volts)
