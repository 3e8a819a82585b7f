"""Parameter table of the force controller, and the controllers by name."""

from collections.abc import Mapping, Sequence
from typing import Any

from seft_msgs_py.config.facts import CHANNELS, POSITION_SERVO, facts
from seft_msgs_py.config.parameter_table import Table, parameter_rows
from seft_msgs_py.config.registered import Registered
from seft_msgs_py.node import host
from seft_plant_sim.rig_parameters import SETTINGS_OF_THE_RIG

from seft_ros.reference_force.reference_force_parameters import SETTINGS_OF_THE_TEST

TRANSFER_FUNCTION = "transfer_function"
VELOCITY_FEEDFORWARD = "velocity_feedforward"
POSITION_SERVO_METHOD = "position_servo"
FOLLOW_TARGETS = VELOCITY_FEEDFORWARD, POSITION_SERVO_METHOD
"""Controllers that follow the motion of a target."""
REGISTERED_CONTROLLERS = Registered("seft.force_control", (TRANSFER_FUNCTION, *FOLLOW_TARGETS))
"""Other packages' controllers: name -> class or function of `ControlInputs` and settings."""


_ROWS = parameter_rows(
    """
    numerator                  | floats | 37.0  |       |           |
        numerator of the controller (force error in N -> valve in V), in s, highest power
        first; default the paper's Eq. 3.1
    denominator                | floats | [1.0, 17.14, 4002.0] |       |           |
        denominator of the controller, likewise
    per_axis                   | bool   | false |       |           |
        whether numerator and denominator contain a polynomial for each axis, in their order,
        instead of one for all
    gain                       | floats | 1.0   |       |           |
        factor from the controllers' outputs to the valves: one number, a diagonal, or a
        matrix that decouples the axes
    feedback                   | bool   | true  |       |           |
        whether the measured force is fed back; if not, the reference force drives the valve
        through the controller (open loop, for identification)
    watchdog.reference_timeout | float  | 0.1   | s     | > 0       |
        with a loop_delay, in realtime: age of the newest reference_force, by the steps of the
        rig, at which the force controller ramps the force down by itself; after the ramp, 0 V until
        the next test. If a valve closes while the specimen still vibrates, the oil column rings
    watchdog.saturation_time   | float  | 0.5   | s     | 0 ..      |
        longest time within one second that the valve command may be at its limit before the
        force controller trips
    """
)
FORCE_CONTROLLER_TABLE = Table(
    "force_controller",
    [
        *facts("loop_delay", "specimen.", "actuator.", "sensors.", "calibration."),
        *facts(*(f"limits.{name}" for name in (*CHANNELS, "displacement_rate", "command"))),
        *SETTINGS_OF_THE_TEST,
        *SETTINGS_OF_THE_RIG,
        REGISTERED_CONTROLLERS.row(
            "method",
            TRANSFER_FUNCTION,
            "the controller: numerator over denominator on each axis, or the flow that a target's "
            f"motion needs ({VELOCITY_FEEDFORWARD}), or the displacement that a servo of kind "
            f"{POSITION_SERVO} obeys ({POSITION_SERVO_METHOD})",
        ),
        REGISTERED_CONTROLLERS.settings_row("settings", "a controller"),
        *_ROWS,
        *host.REALTIME_PARAMETERS,
    ],
)


def fitting_method(section: Mapping[str, Any]) -> str:
    """Name the controller that follows a target with the actuators of a section."""
    servo = section["actuator.kind"] == POSITION_SERVO
    return POSITION_SERVO_METHOD if servo else VELOCITY_FEEDFORWARD


def one_controller(numerator: Sequence[float], denominator: Sequence[float]) -> dict[str, Any]:
    """Give the parameters that select one controller for all axes, independent of earlier ones."""
    return {
        "method": TRANSFER_FUNCTION,
        "per_axis": False,
        "gain": [1.0],
        "numerator": list(numerator),
        "denominator": list(denominator),
    }
