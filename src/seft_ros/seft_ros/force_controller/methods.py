"""Force controllers by the name that a parameter file gives: ours, and those of others."""

from typing import Any

from seft_msgs_py.timebase import Timebase

from seft_ros.force_controller.block import ForceController
from seft_ros.force_controller.force_control import ControlKnowledge, ForceControl
from seft_ros.force_controller.names import REGISTERED, TRANSFER_FUNCTION
from seft_ros.force_controller.registered_control import RegisteredControl


def force_control(
    section: dict[str, Any], axes: tuple[str, ...], timebase: Timebase
) -> ForceControl:
    """Make the controller of a force controller's section of an experiment.

    Raises
    ------
    InputError
        If it can't be made.
    """
    name = section.get("method", TRANSFER_FUNCTION)  # not in an older record
    if name == TRANSFER_FUNCTION:
        return ForceController.from_parameters(section, axes, timebase)
    knowledge = ControlKnowledge(len(axes), timebase.dt, section["voltage_limit"])
    own = REGISTERED.make(name, section["settings"], "force_controller: method", knowledge)
    return RegisteredControl(own, name, knowledge)
