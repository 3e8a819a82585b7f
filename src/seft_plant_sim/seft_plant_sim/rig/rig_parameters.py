"""Parameter table of the rig."""

from seft_msgs_py.config.parameter_table import Parameter, Table
from seft_msgs_py.node import realtime

from seft_plant_sim.rig.limits import limit_rows
from seft_plant_sim.specimen import spring_kinds

PACE = (
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
    Parameter(
        "loop_delay",
        "int",
        0,
        "of an idealised actuator, which obeys reference_force: steps from a state to the first "
        "use of the force that is computed from it",
        minimum=-1,
        maximum=100,
        default_from="reference_force:loop_delay",
    ),
    Parameter("seed", "int", 0, "seed of the sensor noise", minimum=0),
)

SPECIMEN = (
    Parameter("specimen.mass", "floats", None, "mass: one number, a diagonal, or a matrix", "kg"),
    Parameter("specimen.damping", "floats", 0.0, "viscous damping, likewise", "N s/m"),
    Parameter(
        "specimen.stiffness",
        "floats",
        None,
        "stiffness, likewise; as new where it yields, without friction and beyond no gap",
        "N/m",
    ),
    Parameter(
        "specimen.springs",
        "floats",
        0.0,
        "springs that are not linear: deformation of each per displacement of each axis, spring "
        "by spring; 0: one between each axis and the ground",
    ),
    *spring_kinds.PARAMETERS,
)

ACTUATOR = (
    Parameter(
        "actuator.kind",
        "string",
        "servo_hydraulic",
        "ideal and delay (Eq. 5.2) apply the reference force; servo_hydraulic obeys its valve, "
        "servo_hydraulic_linear is its small-signal limit",
        choices=("ideal", "delay", "servo_hydraulic", "servo_hydraulic_linear"),
    ),
    Parameter(
        "actuator.delay", "float", 0.0, "delay of kind delay", "s", minimum=0.0, maximum=10.0
    ),
    # identified; 0: from the data sheets below
    *(
        Parameter(f"actuator.{name}", "floats", 0.0, f"{what}; 0: {source}", unit, minimum=0.0)
        for name, what, source, unit in (
            ("oil_stiffness", "stiffness of the oil column", "4 beta A^2 / V", "N/m"),
            (
                "oil_column_frequency",
                "resonance of the specimen's mass on the oil column, in place of oil_stiffness",
                "not given",
                "Hz",
            ),
            ("flow_gain", "piston velocity for one volt", "from the rated flow", "m/s/V"),
            ("leakage", "leakage rate", "4 beta C / V", "1/s"),
            ("force_capacity", "force without flow", "supply_pressure * piston_area", "N"),
        )
    ),
    # data sheets; the defaults are the paper's rig as docs/rig.md explains
    *(
        Parameter(f"actuator.{name}", "floats", default, what, unit, positive=True)
        for name, default, what, unit in (
            ("piston_area", 1.1836e-3, "net area of the piston, A", "m^2"),
            ("supply_pressure", 20.7e6, "supply pressure", "Pa"),
            ("rated_flow", 2.754e-4, "flow of the open valve at rated_pressure_drop", "m^3/s"),
            ("rated_pressure_drop", 6.9e6, "pressure drop of rated_flow", "Pa"),
            ("rated_voltage", 10.0, "drive at which the valve is fully open", "V"),
            ("bulk_modulus", 0.7e9, "effective bulk modulus of oil, air and hoses, beta", "Pa"),
            ("oil_volume", 2.357e-4, "oil under compression, both chambers, V", "m^3"),
        )
    ),
    Parameter(
        "actuator.leakage_coefficient",
        "floats",
        4.2e-12,
        "leakage flow per load pressure, C",
        "m^3/s/Pa",
        minimum=0.0,
    ),
    Parameter(
        "actuator.valve_frequency",
        "floats",
        70.0,
        "natural frequency of the valve",
        "Hz",
        positive=True,
    ),
    Parameter("actuator.valve_damping", "floats", 0.6, "damping ratio of the valve", positive=True),
    Parameter(
        "actuator.dead_time",
        "float",
        0.001,
        "dead time of the valve",
        "s",
        minimum=0.0,
        maximum=1.0,
    ),
    Parameter("actuator.friction", "floats", 0.0, "Coulomb friction of the piston", "N", minimum=0),
    Parameter(
        "actuator.friction_velocity",
        "floats",
        0.005,
        "velocity over which Coulomb friction builds up",
        "m/s",
        positive=True,
    ),
    Parameter(
        "actuator.viscous_friction",
        "floats",
        0.0,
        "viscous friction of the piston",
        "N s/m",
        minimum=0.0,
    ),
    Parameter(
        "actuator.stroke",
        "floats",
        0.076,
        "displacement either way at which the piston meets its stops",
        "m",
        positive=True,
    ),
)

SENSORS = (
    *(
        Parameter(
            f"sensors.{name}_{row}",
            "floats",
            0.0,
            f"{text} of {quantity}{end}",
            unit,
            minimum=None if row == "bias" else 0.0,
        )
        for row, text, end in (
            ("noise", "RMS noise", ""),
            ("bias", "constant error", ""),
            ("range", "range", " either way, where the sensor saturates; 0: no end"),
        )
        for name, quantity, unit in (
            ("position", "displacement", "m"),
            ("velocity", "velocity", "m/s"),
            ("acceleration", "acceleration", "m/s^2"),
            ("force", "force", "N"),
        )
    ),
    Parameter(
        "sensors.adc_bits",
        "int",
        0,
        "bits of the analog-digital converter over each range; 0: exact",
        minimum=0,
        maximum=32,
    ),
    Parameter(
        "sensors.anti_alias",
        "float",
        0.0,
        "cut-off of the anti-aliasing filters (Butterworth, second order); 0: none",
        "Hz",
        minimum=0.0,
    ),
    Parameter(
        "sensors.velocity",
        "string",
        "measured",
        "measured, or derived from the measured displacement by a filtered derivative",
        choices=("measured", "derived"),
    ),
    Parameter(
        "sensors.velocity_cutoff",
        "float",
        100.0,
        "cut-off of that derivative",
        "Hz",
        positive=True,
    ),
)

TABLE = Table(
    "rig",
    [
        *PACE,
        *SPECIMEN,
        *ACTUATOR,
        *SENSORS,
        *limit_rows(default_from="supervisor"),
        Parameter(
            "limits.command",
            "float",
            10.0,
            "largest valve command, either way, that the rig applies; one beyond it is refused. "
            "Idealised actuators refuse a reference force beyond limits.force instead",
            "V",
            positive=True,
            default_from="force_controller:voltage_limit",
        ),
        Parameter(
            "safe.valve_command",
            "floats",
            0.0,
            "valve command when a test trips or is stopped; an idealised actuator lets go instead",
            "V",
        ),
        Parameter(
            "safe.settle_time",
            "float",
            0.2,
            "longest time that the simulated rig is followed to rest after that; 0: not at all",
            "s",
            minimum=0.0,
            maximum=60.0,
        ),
        Parameter(
            "watchdog.command_timeout",
            "float",
            0.02,
            "in realtime: longest time without a new command before the rig trips",
            "s",
            positive=True,
            default_from="supervisor:watchdog.command_timeout",
        ),
        Parameter(
            "watchdog.supervisor_timeout",
            "float",
            1.0,
            "longest silence of the supervisor before the rig trips",
            "s",
            positive=True,
        ),
        *realtime.PARAMETERS,
    ],
)
