"""The blocks of a test as arrays, for the compiled loop."""

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view
from seft_msgs_py.topics import VALVE_COMMAND
from seft_plant_sim.rig import Rig

from seft_ros.ensemble.loop_steps import ControlArrays, ForceArrays
from seft_ros.force_controller.block import ForceController
from seft_ros.force_controller.interlock import Interlock
from seft_ros.interlock.instability import InstabilityWatch
from seft_ros.interlock.plausibility import PlausibleState
from seft_ros.interlock.protected_force import ProtectedForce
from seft_ros.reference_force.compensation.linear_filter import LinearCompensator

Floats = npt.NDArray[np.float64]


class NotLinearError(Exception):
    """A block can't be put into arrays; the text says which, and why."""


def force_arrays(block: ProtectedForce, known: Floats, steps: int) -> ForceArrays:
    """Arrays of a reference force under a ground motion.

    Parameters
    ----------
    block : ProtectedForce
        The block.
    known : ndarray
        Ground motion, and what is known beyond its end, shape (N + lead, n).
    steps : int
        N.

    Raises
    ------
    NotLinearError
        If its compensation is not linear, or others than the usual guards watch it.
    """
    compensator = block.reference_force.compensator
    if type(compensator) is not LinearCompensator:
        raise NotLinearError("the compensation changes while the test runs")
    if "step" in vars(compensator):
        raise NotLinearError("the compensation has a step of its own")
    if [type(guard) for guard in block.guards] != [PlausibleState, InstabilityWatch]:
        raise NotLinearError("other guards than the usual watch the reference force")
    watch = block.guards[1]
    assert isinstance(watch, InstabilityWatch)
    own = compensator.linear()
    windows = sliding_window_view(known, 1 + own.preview, axis=0)[:steps].transpose(0, 2, 1)
    driven = windows.reshape(steps, -1) @ np.vstack([own.e, own.h]).T
    return ForceArrays(
        np.block([[own.c, own.d], [own.a, own.b]]),
        driven,
        _c(known[:steps]),
        block.plausible.largest,
        block.plausible.most,
        _c(watch.product),
        watch.average,
        watch.memory,
        watch.patience,
        float(watch.ratio),
        watch.floor**2,
        block.ramp.steps,
    )


def control_arrays(interlock: Interlock, rig: Rig) -> ControlArrays:
    """Arrays of a force controller and its interlock."""
    controller, limited = interlock.controller, interlock.saturated
    if not isinstance(controller, ForceController):
        raise NotLinearError("a force controller that is no transfer function")
    return ControlArrays(
        _c(controller.matrix),
        _c(controller.from_drive),
        controller.feedback,
        controller.limit,
        float(interlock.largest),
        limited.allowed,
        limited.window,
        rig.drive == VALVE_COMMAND.name,
    )


def _c(values: npt.NDArray[np.floating]) -> Floats:
    """Contiguous, and one's own: the compiler knows one kind of array alone."""
    return np.array(values, dtype=np.float64, order="C")
