"""Several simulated rigs as one: each has its own axes, and all are stepped together."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.outcome import Saturation
from seft_msgs_py.rigs import RigAxes
from seft_msgs_py.timebase import Timebase

from seft_plant_sim.continuous_model import Drive
from seft_plant_sim.rig import Rig

Floats = npt.NDArray[np.float64]


class Rigs:
    """The rigs of a test, as the offline loop steps them: the bits of each are those of its node.

    Parameters
    ----------
    rigs : sequence of (RigAxes, Rig)
        Which axes each has, and the rig.
    """

    def __init__(self, rigs: Sequence[tuple[RigAxes, Rig]]) -> None:
        self._rigs = [(list(of.places), rig) for of, rig in rigs]
        self._axes = sum(len(places) for places, _ in self._rigs)

    @classmethod
    def from_parameters(
        cls,
        section: dict[str, Any],
        axes: tuple[str, ...],
        timebase: Timebase,
        rigs: Sequence[RigAxes],
    ) -> "Rigs":
        """Make them of the rig's section of an experiment, see `Rig.from_parameters`."""
        return cls([(one, Rig.from_parameters(section, axes, timebase, one)) for one in rigs])

    @property
    def drive(self) -> Drive:
        """Topic that drives the actuators."""
        return self._rigs[0][1].drive

    @property
    def violation(self) -> str | None:
        """The limit that the last sample of a rig breaks; of several rigs the first counts."""
        return next((rig.violation for _, rig in self._rigs if rig.violation), None)

    @property
    def saturation(self) -> Saturation:
        """What has been at the end of its range on any of them."""
        return Saturation.of_all([rig.saturation for _, rig in self._rigs])

    def reset(self) -> Floats:
        """Bring the rigs to rest and take the sample of step 0, shape (4, n)."""
        state = np.empty((4, self._axes))
        for places, rig in self._rigs:
            state[:, places] = rig.reset()
        return state

    def step(self, command: Floats) -> Floats:
        """Apply a command and take the next sample, see `Rig.step`."""
        state = np.empty((4, self._axes))
        for places, rig in self._rigs:
            state[:, places] = rig.step(command[places])
        return state
