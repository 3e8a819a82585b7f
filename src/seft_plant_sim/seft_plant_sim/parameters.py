"""Parameter table of the rig."""

from seft_msgs_py.parameters import Parameter, Table

from seft_plant_sim.limits import limit_rows

TABLE = Table(
    "rig",
    [
        Parameter(
            "pace",
            "string",
            "realtime",
            "realtime: absolute deadlines, a missing command holds the last; "
            "lockstep: each step waits for its command",
            choices=("realtime", "lockstep"),
        ),
        Parameter(
            "lockstep_timeout",
            "float",
            5.0,
            "longest wait for a command in lockstep",
            "s",
            positive=True,
        ),
        Parameter("seed", "int", 0, "seed of the sensor noise", minimum=0),
        Parameter("specimen.kind", "string", "linear", "restoring force law", choices=("linear",)),
        Parameter(
            "specimen.mass", "floats", None, "mass: one number, a diagonal, or a matrix", "kg"
        ),
        Parameter("specimen.damping", "floats", 0.0, "viscous damping, likewise", "N s/m"),
        Parameter("specimen.stiffness", "floats", None, "stiffness, likewise", "N/m"),
        Parameter(
            "actuator.kind",
            "string",
            "servo_hydraulic",
            "ideal and delay (Eq. 5.2) apply the reference force; servo_hydraulic obeys its valve",
            choices=("ideal", "delay", "servo_hydraulic"),
        ),
        Parameter(
            "actuator.delay", "float", 0.0, "delay of kind delay", "s", minimum=0.0, maximum=10.0
        ),
        Parameter(
            "actuator.oil_stiffness", "floats", 1.664e7, "stiffness of the oil column", "N/m"
        ),
        Parameter("actuator.leakage", "floats", 20.0, "leakage rate", "1/s", minimum=0.0),
        Parameter("actuator.flow_gain", "floats", 0.03853, "piston velocity for one volt", "m/s/V"),
        Parameter(
            "actuator.valve_frequency",
            "floats",
            60.0,
            "natural frequency of the valve",
            "Hz",
            positive=True,
        ),
        Parameter(
            "actuator.valve_damping", "floats", 0.7, "damping ratio of the valve", positive=True
        ),
        Parameter(
            "actuator.dead_time",
            "float",
            0.001,
            "dead time of the valve",
            "s",
            minimum=0.0,
            maximum=1.0,
        ),
        Parameter(
            "sensors.position_noise", "floats", 0.0, "RMS noise of displacement", "m", minimum=0.0
        ),
        Parameter(
            "sensors.velocity_noise", "floats", 0.0, "RMS noise of velocity", "m/s", minimum=0.0
        ),
        Parameter(
            "sensors.acceleration_noise",
            "floats",
            0.0,
            "RMS noise of acceleration",
            "m/s^2",
            minimum=0.0,
        ),
        Parameter("sensors.force_noise", "floats", 0.0, "RMS noise of force", "N", minimum=0.0),
        *limit_rows(default_from="supervisor"),
        Parameter(
            "watchdog.command_timeout",
            "float",
            0.1,
            "in realtime: longest time without a new command before the rig trips",
            "s",
            positive=True,
            default_from="supervisor:watchdog.command_timeout",
        ),
    ],
)
