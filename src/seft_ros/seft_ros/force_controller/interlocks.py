"""The force controllers of several rigs as one: each sees its own axes alone."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.wire.topics import RigAxes

from seft_ros.force_controller.interlock import Interlock
from seft_ros.force_controller.methods import force_control

Floats = npt.NDArray[np.float64]


class Interlocks:
    """The `Interlock` of each rig of a test, as the offline loop steps them.

    Parameters
    ----------
    rigs : sequence of (RigAxes, Interlock)
        Which axes each has, and its interlock.
    """

    def __init__(self, rigs: Sequence[tuple[RigAxes, Interlock]]) -> None:
        self._rigs = [(list(of.places), interlock) for of, interlock in rigs]

    @property
    def reason(self) -> str:
        """Why one of them has tripped, of several the first; empty while none has."""
        return next((one.reason for _, one in self._rigs if one.reason), "")

    def reset(self) -> None:
        """Forget the test so far, a trip too."""
        for _, interlock in self._rigs:
            interlock.reset()

    def step(self, index: int, points: Floats, state: Floats) -> Floats:
        """Compute the valve drives of one step, see `Interlock.step`."""
        drive = np.empty(state.shape[1])
        for places, interlock in self._rigs:
            drive[places] = interlock.step(index, points[:, :, places], state[:, places])
        return drive


def interlock_of(experiment: Experiment) -> Interlock | Interlocks:
    """Make what answers states and reference forces with valve drives, for all rigs of a test.

    Raises
    ------
    InputError
        If the force controller of a rig can't be made.
    """
    section, axes, timebase = experiment["force_controller"], experiment.axes, experiment.timebase
    made = []
    for rig in experiment.rigs:
        controller = force_control(section, axes, timebase, rig)
        made.append((rig, Interlock.from_parameters(controller, section, axes, timebase, rig)))
    return made[0][1] if len(made) == 1 else Interlocks(made)
