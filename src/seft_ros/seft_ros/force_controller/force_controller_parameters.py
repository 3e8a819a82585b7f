"""Parameter table of the force controller, and the controllers by name."""

from collections.abc import Sequence
from typing import Any

from seft_msgs_py.config.parameter_table import Table, parameter_rows
from seft_msgs_py.config.registered import Registered
from seft_msgs_py.node import host

TRANSFER_FUNCTION = "transfer_function"
VELOCITY_FEEDFORWARD = "velocity_feedforward"
REGISTERED_CONTROLLERS = Registered("seft.force_control", (TRANSFER_FUNCTION, VELOCITY_FEEDFORWARD))
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
    actuator.flow_gain         | floats | 0.0   | m/s/V | 0 ..      |
        velocity_feedforward: piston velocity for one volt, as seft identify finds it; 0:
        not known
    actuator.oil_stiffness     | floats | 0.0   | N/m   | 0 ..      |
        velocity_feedforward: stiffness of the oil column, likewise
    actuator.leakage           | floats | 0.0   | 1/s   | 0 ..      |
        velocity_feedforward: rate at which the force decays by leakage
    actuator.force_capacity    | floats | 0.0   | N     | 0 ..      |
        velocity_feedforward: force at supply pressure; 0: very large, so that the load does
        not change the flow
    actuator.valve_frequency   | floats | 0.0   | Hz    | 0 ..      |
        velocity_feedforward: natural frequency of the valve; 0: not known
    actuator.valve_damping     | floats | 0.7   |       | 0 ..      |
        velocity_feedforward: damping ratio of the valve
    actuator.dead_time         | floats | 0.0   | s     | 0 ..      |
        velocity_feedforward: dead time of the valve, without the loop's own step and sensor_lag
    sensor_lag | float | reference_force:compensation.sensor_lag or 0.0 | s | 0 .. 1 |
        lag of the measured state, which adds to that dead time, for the detectors, too
    noise.position | floats | reference_force:compensation.noise.position or 0.0 | m | 0 .. |
        velocity_feedforward: RMS noise of the measured displacement
    noise.velocity | floats | reference_force:compensation.noise.velocity or 0.0 | m/s | 0 .. |
        velocity_feedforward: RMS noise of the measured velocity
    noise.acceleration | floats | reference_force:compensation.noise.acceleration or 0.0 | m/s^2 | 0
        .. | velocity_feedforward: RMS noise of the measured acceleration
    noise.force | floats | reference_force:compensation.noise.force or 0.0 | N | 0 .. |
        velocity_feedforward: RMS noise of the measured force
    noise.velocity_source | string | reference_force:compensation.noise.velocity_source or measured
        |  | measured, derived | velocity_feedforward: whether the velocity is measured, or
        derived
    horizon | float | reference_force:compensation.horizon or 0.05 | s | > 0 .. 1 |
        velocity_feedforward: how far ahead the planned motion is used; four times sensor_lag is
        added
    detectors.specimen_mass | floats | reference_force:model.mass or 0.0 | kg | |
        mass of the specimen, for the detectors (docs/safety.md); 0: not known
    detectors.specimen_stiffness | floats | reference_force:model.stiffness or 0.0 | N/m | |
        stiffness of the specimen, likewise
    detectors.mass_ratio | float | reference_force:mass_ratio or 0.0 | | |
        computed mass over that of the specimen, likewise
    detectors.test | string | reference_force:method or seft | | seft, eft |
        method of reference_force, likewise
    detectors.actuator_kind | string | reference_force:compensation.actuator_kind or
        servo_hydraulic | | ideal, delay, servo_hydraulic, servo_hydraulic_linear |
        kind of the actuators, likewise: ideal and delay have no valve
    detectors.position_range | floats | rig:sensors.position_range or 0.0 | m | 0 .. |
        largest displacement that the sensor can measure, likewise; 0: not known
    detectors.velocity_range | floats | rig:sensors.velocity_range or 0.0 | m/s | 0 .. |
        largest velocity that the sensor can measure, likewise; 0: not known
    detectors.acceleration_range | floats | rig:sensors.acceleration_range or 0.0 | m/s^2 | 0 .. |
        largest acceleration that the sensor can measure, likewise; 0: not known
    detectors.force_range | floats | rig:sensors.force_range or 0.0 | N | 0 .. |
        largest force that the sensor can measure, likewise; 0: not known
    detectors.warn_only | string | | | |
        detectors that warn but do not end a test: their names, separated by commas, or all
    voltage_limit              | float  | 10.0  | V     | > 0       |
        largest valve drive, in both directions
    feedback                   | bool   | true  |       |           |
        whether the measured force is fed back; if not, the reference force drives the valve
        through the controller (open loop, for identification)
    loop_delay                 | int    | reference_force:loop_delay or 0 |       | -1 .. 100 |
        steps from a state to the first use of the reference force that is computed from it;
        0: each state is answered when its reference force has arrived; -1: not 0, and
        measured before the test
    limits.force               | float  | supervisor:limits.force or 22200.0 | N     | > 0       |
        largest reference force on any axis; a larger one is refused
    limits.displacement        | float  | supervisor:limits.displacement or 0.076 | m | > 0 |
        largest displacement; if the noise of a sensor is not configured, a thousandth of its limit
        is assumed
    limits.velocity            | float  | supervisor:limits.velocity or 0.5 | m/s | > 0 |
        largest velocity, likewise
    limits.acceleration        | float  | supervisor:limits.acceleration or 98.1 | m/s^2 | > 0 |
        largest acceleration, likewise
    watchdog.state_timeout | float | supervisor:watchdog.command_timeout or 0.02 | s | > 0 |
        in realtime: longest time without a new rig/state in a running test before the force
        controller trips and answers 0 V until the next test
    watchdog.reference_timeout | float  | 0.1   | s     | > 0       |
        with a loop_delay, in realtime: age of the newest reference_force, by the steps of the
        rig, at which the force controller ramps the force down by itself
    watchdog.ramp_down_time | float | reference_force:ramp_down_time or 0.5 | s | > 0 .. 60 |
        time of that ramp; after it, 0 V until the next test. If a valve closes while the
        specimen still vibrates, the oil column rings
    watchdog.saturation_time   | float  | 0.5   | s     | 0 ..      |
        longest time within one second that the valve command may be at its limit before the
        force controller trips
    watchdog.close_time | float | rig:safe.close_time or 0.02 | s | 0 .. 1 |
        time in which the force controller closes the valve after a trip
    plant.numerator            | floats | [0.0] |       |           |
        numerator of the identified response from valve command in V to force in N, in s,
        highest power first; 0: not known. For preflight; the loop does not use
        it
    plant.denominator          | floats | [1.0] |       |           | its denominator, likewise
    plant.dead_time            | float  | 0.0   | s     | 0 .. 1    |
        its dead time, without the loop's own step of latency and sensor_lag
    """
)
FORCE_CONTROLLER_TABLE = Table(
    "force_controller",
    [
        REGISTERED_CONTROLLERS.row(
            "method",
            TRANSFER_FUNCTION,
            "the controller: numerator over denominator on each axis, or the flow that a target's "
            f"motion needs ({VELOCITY_FEEDFORWARD})",
        ),
        REGISTERED_CONTROLLERS.settings_row("settings", "a controller"),
        *_ROWS,
        *host.REALTIME_PARAMETERS,
    ],
)


def one_controller(numerator: Sequence[float], denominator: Sequence[float]) -> dict[str, Any]:
    """Give the parameters that select one controller for all axes, independent of earlier ones."""
    return {
        "method": TRANSFER_FUNCTION,
        "per_axis": False,
        "gain": [1.0],
        "numerator": list(numerator),
        "denominator": list(denominator),
    }
