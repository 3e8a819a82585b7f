"""Force controllers by their name in a parameter file: ours, and those of other packages."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.parameter_table import Section
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import RigAxes, Timebase
from seft_plant_sim.judge.known_rig import command_limit

from seft_ros.force_controller import force_controller_parameters as controllers
from seft_ros.force_controller.force_control import ControlInputs, ForceControl, ForceController
from seft_ros.force_controller.position_servo import PositionServo
from seft_ros.force_controller.velocity_feedforward import VelocityFeedforward
from seft_ros.reference_force.compensator import RegisteredPart


class RegisteredControl(RegisteredPart):
    """Limits the drive of another package's controller.

    Parameters
    ----------
    make : callable
        Makes the controller: an object with ``step(reference_force, state)``, the force of shape
        (n,), in N; its drive may be beyond the limit. Without ``reset()`` it is made again for each
        test. With ``linear()``, preflight computes its margins. If it has ``limited(drive)``, this
        is called with each drive that was cut off, so that the controller does not wind up.
    name : str
        As registered.
    inputs : ControlInputs
        The known data of the test.

    Attributes
    ----------
    limited, shape
        See `ForceControl`.

    Raises
    ------
    InputError
        If its drive is not one value for each axis.
    """

    shape = 1, 1

    def __init__(self, make: Callable[[], Any], name: str, inputs: ControlInputs) -> None:
        super().__init__("force_controller: method", name, make, "reference_force, state")
        self._limit, n = inputs.voltage_limit, inputs.axes
        self._check_shape("drive", "V", self._own.step(np.zeros(n), np.zeros((4, n))), n)
        self.reset()

    def reset(self) -> None:
        """See `ForceControl.reset`."""
        super().reset()
        self.limited = False

    def step(self, points: Floats, state: Floats) -> Floats:
        """See `ForceControl.step`."""
        drive = np.clip(self._own.step(points[0, -1], state), -self._limit, self._limit)
        self.limited = bool((np.abs(drive) >= self._limit).any())
        if self.limited and hasattr(self._own, "limited"):
            self._own.limited(drive)
        return drive


_OURS: dict[str, Callable[..., ForceControl]] = {
    controllers.TRANSFER_FUNCTION: ForceController.from_parameters,
    controllers.VELOCITY_FEEDFORWARD: VelocityFeedforward,
    controllers.POSITION_SERVO_METHOD: PositionServo,
}


def force_control(
    section: Section, axes: tuple[str, ...], timebase: Timebase, rig: RigAxes | None = None
) -> ForceControl:
    """Make the controller from a force controller's section of an experiment.

    Parameters
    ----------
    section : dict
        Parameters, for all axes.
    axes : tuple of str
        Names of all axes.
    timebase : Timebase
        Sampling clock.
    rig : RigAxes, optional
        With several rigs, the one that it controls; default all axes.

    Raises
    ------
    InputError
        If it can't be made, or mixes axes of several rigs.
    """
    own = rig or RigAxes.whole(axes)
    name, fitting = section["method"], controllers.fitting_method(section)
    if name in controllers.FOLLOW_TARGETS and name != fitting:
        kind = f"an actuator of kind {section['actuator.kind']}; make that {fitting}"
        raise InputError(f"force_controller: method {name} does not drive {kind}")
    if name in _OURS:
        return _OURS[name](section, axes, timebase, own)
    inputs = ControlInputs(len(own.axes), timebase.dt, command_limit(section))
    known, where = controllers.REGISTERED_CONTROLLERS, "force_controller: method"
    make = partial(known.make, name, section["settings"], where, inputs)
    return RegisteredControl(make, name, inputs)
