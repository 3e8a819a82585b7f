"""Parameter table of the force controller."""

from seft_msgs_py.config.parameter_table import Parameter, Table
from seft_msgs_py.node import realtime

from seft_ros.force_controller.names import REGISTERED, TRANSFER_FUNCTION, VELOCITY_FEEDFORWARD

TABLE = Table(
    "force_controller",
    [
        Parameter(
            "method",
            "string",
            TRANSFER_FUNCTION,
            "the controller: numerator over denominator on each axis, the flow that a target's "
            f"motion needs ({VELOCITY_FEEDFORWARD}), or another package's",
            choices=REGISTERED.names,
        ),
        REGISTERED.settings_row("settings", "a controller"),
        Parameter(
            "numerator",
            "floats",
            37.0,
            "numerator of the controller (force error in N -> valve in V), in s, highest power "
            "first; default the paper's Eq. 3.1",
        ),
        Parameter(
            "denominator", "floats", [1.0, 17.14, 4002.0], "denominator of the controller, likewise"
        ),
        Parameter(
            "per_axis",
            "bool",
            False,
            "whether numerator and denominator hold a polynomial for each axis, one after the "
            "other, instead of one for all",
        ),
        Parameter(
            "gain",
            "floats",
            1.0,
            "what valves get of the controllers' outputs: one number, a diagonal, or a matrix that "
            "decouples the axes",
        ),
        *(
            Parameter(
                f"actuator.{name}",
                "floats",
                default,
                f"{VELOCITY_FEEDFORWARD}: {what}",
                unit,
                minimum=0.0,
            )
            for name, default, what, unit in (
                (
                    "flow_gain",
                    0.0,
                    "piston velocity for one volt, as seft identify finds it; 0: not known",
                    "m/s/V",
                ),
                ("oil_stiffness", 0.0, "stiffness of the oil column, likewise", "N/m"),
                ("leakage", 0.0, "rate at which leakage lets a force decay", "1/s"),
                (
                    "force_capacity",
                    0.0,
                    "force at which the supply pressure is used up; 0: so much "
                    "that the valve does not feel the load",
                    "N",
                ),
                ("valve_frequency", 0.0, "natural frequency of the valve; 0: not known", "Hz"),
                ("valve_damping", 0.7, "damping ratio of the valve", ""),
                ("dead_time", 0.0, "dead time of the valve, without the loop's own step", "s"),
            )
        ),
        *(
            Parameter(
                f"noise.{name}",
                "floats",
                0.0,
                f"{VELOCITY_FEEDFORWARD}: RMS noise of the measured {quantity}",
                unit,
                minimum=0.0,
                default_from=f"reference_force:compensation.noise.{name}",
            )
            for name, quantity, unit in (
                ("position", "displacement", "m"),
                ("velocity", "velocity", "m/s"),
                ("acceleration", "acceleration", "m/s^2"),
                ("force", "force", "N"),
            )
        ),
        Parameter(
            "noise.velocity_source",
            "string",
            "measured",
            f"{VELOCITY_FEEDFORWARD}: whether the velocity is measured, or derived",
            choices=("measured", "derived"),
            default_from="reference_force:compensation.noise.velocity_source",
        ),
        Parameter(
            "horizon",
            "float",
            0.05,
            f"{VELOCITY_FEEDFORWARD}: time ahead for which the coming motion is used",
            "s",
            positive=True,
            maximum=1.0,
            default_from="reference_force:compensation.horizon",
        ),
        Parameter(
            "voltage_limit", "float", 10.0, "largest valve drive, either way", "V", positive=True
        ),
        Parameter(
            "feedback",
            "bool",
            True,
            "whether the measured force is fed back; without, the reference force drives the "
            "valve through the controller (open loop, for identification)",
        ),
        Parameter(
            "loop_delay",
            "int",
            0,
            "steps from a state to the first use of the reference force that is computed from it; "
            "0: each state is answered when its reference force has come; -1: other than 0, and "
            "measured before the test",
            minimum=-1,
            maximum=100,
            default_from="reference_force:loop_delay",
        ),
        Parameter(
            "limits.force",
            "float",
            22200.0,
            "largest reference force on any axis; one beyond it is refused",
            "N",
            positive=True,
            default_from="supervisor:limits.force",
        ),
        Parameter(
            "watchdog.state_timeout",
            "float",
            0.02,
            "in realtime: longest time without a new rig/state in a running test before the force "
            "controller trips and answers 0 V until the next test",
            "s",
            positive=True,
            default_from="supervisor:watchdog.command_timeout",
        ),
        Parameter(
            "watchdog.reference_timeout",
            "float",
            0.1,
            "with a loop_delay, in realtime: age of the newest reference_force in steps of the "
            "rig, in s, at which the force controller brings the force down by itself",
            "s",
            positive=True,
        ),
        Parameter(
            "watchdog.ramp_down_time",
            "float",
            0.5,
            "time in which it then does so; after it, 0 V until the next test. A valve that closes "
            "on a specimen that still vibrates makes it ring",
            "s",
            positive=True,
            maximum=60.0,
            default_from="reference_force:ramp_down_time",
        ),
        Parameter(
            "watchdog.saturation_time",
            "float",
            0.5,
            "longest time within one second that the valve command may be at its limit before the "
            "force controller trips",
            "s",
            minimum=0.0,
        ),
        Parameter(
            "plant.numerator",
            "floats",
            [0.0],
            "numerator of the identified response from valve command in V to force in N, in s, "
            "highest power first; 0: not known. For design and preflight, the loop does not use it",
        ),
        Parameter("plant.denominator", "floats", [1.0], "its denominator, likewise"),
        Parameter(
            "plant.dead_time",
            "float",
            0.0,
            "its dead time; the loop's own step of latency is not in it",
            "s",
            minimum=0.0,
            maximum=1.0,
        ),
        *realtime.PARAMETERS,
    ],
)
