"""Force controllers by the name that a parameter file gives: ours, and those of others."""

from functools import partial
from typing import Any

from seft_msgs_py.wire.timebase import Timebase
from seft_msgs_py.wire.topics import RigAxes

from seft_ros.force_controller.block import ForceController
from seft_ros.force_controller.force_control import ControlKnowledge, ForceControl
from seft_ros.force_controller.names import REGISTERED, TRANSFER_FUNCTION, VELOCITY_FEEDFORWARD
from seft_ros.force_controller.registered_control import RegisteredControl
from seft_ros.force_controller.velocity_feedforward import VelocityFeedforward


def force_control(
    section: dict[str, Any],
    axes: tuple[str, ...],
    timebase: Timebase,
    rig: RigAxes | None = None,
) -> ForceControl:
    """Make the controller of a force controller's section of an experiment.

    Parameters
    ----------
    section : dict
        Parameters, for all axes.
    axes : tuple of str
        Names of all axes.
    timebase : Timebase
        Sampling clock.
    rig : RigAxes, optional
        The one of several rigs that it controls; default all axes.

    Raises
    ------
    InputError
        If it can't be made, or mixes axes of several rigs.
    """
    own = rig or RigAxes.whole(axes)
    name = section.get("method", TRANSFER_FUNCTION)  # not in an older record
    if name == TRANSFER_FUNCTION:
        return ForceController.from_parameters(section, axes, timebase, own)
    if name == VELOCITY_FEEDFORWARD:
        return VelocityFeedforward.from_parameters(section, axes, timebase, own)
    knowledge = ControlKnowledge(len(own.axes), timebase.dt, section["voltage_limit"])
    make = partial(
        REGISTERED.make, name, section["settings"], "force_controller: method", knowledge
    )
    return RegisteredControl(make, name, knowledge)
