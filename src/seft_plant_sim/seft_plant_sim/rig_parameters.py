"""Parameter table of the rig."""

from dataclasses import replace

from seft_msgs_py.config.parameter_table import Parameter, Table, parameter_rows
from seft_msgs_py.config.registered import Registered
from seft_msgs_py.node import host

_OWN = ("linear", "bilinear", "bouc_wen", "pinching", "flag", "friction", "gap", "duffing")
RESTORING_FORCES = Registered("seft.restoring_force", _OWN)
"""Laws of other packages: kind -> class or function for a `springs.HystereticSpring`.

It receives elastic stiffness in N/m, yield displacement in m, and hardening ratio, and may take
settings.
"""

# Rates are over 2 ms, `limits.RATE_SPAN`. Successful tests of config/jhu.yaml and config/demo.yaml
# reach 0.48, 26, 3e3 and 1.4e5; with valve and accelerometer driven into saturation 0.48, 51, 1.5e4
# and 6.5e5. An accelerometer's full range of 4 g at the oil column's 90 Hz is 2.2e4.
_OF_THE_PAPER = {
    "displacement": (0.076, "m"),
    "velocity": (0.5, "m/s"),
    "acceleration": (98.1, "m/s^2"),
    "force": (22200.0, "N"),
    "displacement_rate": (3.0, "m/s"),
    "velocity_rate": (300.0, "m/s^2"),
    "acceleration_rate": (3e4, "m/s^3"),
    "force_rate": (0.0, "N/s"),  # that of any rig, see `limits.largest_force_rate`
}
LIMIT_ROWS = tuple(_OF_THE_PAPER)
LIMIT_NAMES = LIMIT_ROWS[:4]
LIMIT_UNITS = tuple(unit for _, unit in _OF_THE_PAPER.values())


def limit_rows(default_from: str = "") -> list[Parameter]:
    """Rows ``limits.*`` of a parameter table; defaults are those of a node, or the paper's rig."""
    largest = "largest {} on any axis; beyond it the test trips"
    change = (
        "largest change of the measured {} within 2 ms, or one sample if that is longer, per "
        "second; beyond it, as when a sensor or its cable breaks, the test trips"
    )
    rows = []
    for name, (default, unit) in _OF_THE_PAPER.items():
        text = (largest if name in LIMIT_NAMES else change).format(name.removesuffix("_rate"))
        row = Parameter(f"limits.{name}", "float", default, text, unit, positive=default > 0)
        if not row.positive:
            row = replace(row, description=f"{text}; 0: limits.force within 2 ms", minimum=0.0)
        rows.append(row)
    rows += parameter_rows(
        """
        saturated_time | float | 0.05 | s | 0 .. |
            longest time within one second that sensors may be saturated, before the test trips
        """,
        "limits",
    )
    if not default_from:
        return rows
    return [replace(row, default_from=f"{default_from}:{row.name}") for row in rows]


_PACE = parameter_rows(
    """
    pace | string | realtime |  | realtime, lockstep |
        realtime: absolute deadlines, a missing command is that of the stop in reserve, or the
        last; lockstep: each step waits for its command
    lockstep_timeout | float | 5.0 | s | > 0  | longest wait for a command in lockstep
    loop_delay | int | reference_force:loop_delay or 0 |  | -1 .. 100 |
        for an idealised actuator, which obeys reference_force: steps from a state to the first use
        of the force that is computed from it
    seed             | int   | 0   |   | 0 .. | seed of the sensor noise
    """
)

_FAULTS = Parameter(
    "faults",
    "texts",
    "",
    "what fails in the simulated rig, one line a fault, [AXIS/]WHAT KIND [VALUE] at TIME [for "
    "STEPS], as force scale 0.7 at 5.25 for 100; docs/rig.md has the kinds",
)

SPECIMEN = parameter_rows(
    """
    mass      | floats |     | kg    |  | mass: one number, a diagonal, or a matrix
    damping   | floats | 0.0 | N s/m |  | viscous damping, likewise
    stiffness | floats |     | N/m   |  |
        initial elastic stiffness, likewise; without friction, and with open gaps
    springs   | floats | 0.0 |       |  |
        nonlinear springs: deformation of each per displacement of each axis, spring by spring; 0:
        one between each axis and the ground
    """,
    "specimen",
)

SPRINGS = (
    RESTORING_FORCES.row(
        "specimen.kind",
        "linear",
        "restoring force: linear, bilinear with kinematic hardening, Bouc-Wen, Bouc-Wen with "
        "pinching, flag-shaped (self-centring), Coulomb friction parallel to the spring, a second "
        "spring behind a gap, or Duffing's cubic spring",
    ),
    RESTORING_FORCES.settings_row("specimen.settings", "a restoring force"),
    *parameter_rows(
        """
        yield_displacement      | floats | 0.0  | m     | 0 ..       |
            deformation at which a spring yields, for all or per spring
        hardening_ratio         | floats | 0.05 |       | 0 .. 0.999 |
            stiffness after yielding over the elastic one, likewise
        bouc_wen.exponent       | float  | 1.0  |       | 1 ..       | sharpness of yielding, n
        bouc_wen.beta           | float  | 0.5  |       |            | shape of unloading, beta
        bouc_wen.gamma          | float  | 0.5  |       |            | shape of unloading, gamma
        bouc_wen.amplitude_loss | float  | 0.0  |       | 0 ..       |
            degradation of amplitude per work of yield force times yield displacement (Baber & Wen
            1981, delta_A)
        bouc_wen.strength_loss  | float  | 0.0  |       | 0 ..       |
            degradation of strength per work of yield force times yield displacement (Baber & Wen
            1981, delta_nu)
        bouc_wen.stiffness_loss | float  | 0.0  |       | 0 ..       |
            degradation of stiffness per work of yield force times yield displacement (Baber & Wen
            1981, delta_eta)
        pinching.slip           | float  | 1.0  |       | 0 ..       |
            half of the fully developed slip at each passage through zero force, over the yield
            displacement; the other parameters are those of bouc_wen
        pinching.growth         | float  | 0.1  |       | > 0        |
            growth of the slip per work of yield force times yield displacement
        pinching.width          | float  | 0.15 |       | > 0        |
            force range in which it slips, over the yield force
        flag.dissipation        | floats | 0.5  |       | 0 .. 1     |
            height of the flag over the yield force, for all or per spring; 0: no dissipation
        friction.force          | floats | 0.0  | N     | 0 ..       |
            friction parallel to each spring, for all or per spring
        friction.presliding     | float  | 2e-5 | m     | > 0        |
            elastic displacement before it slides
        gap.width               | floats | 0.0  | m     | 0 ..       |
            deformation in both directions at which the second spring engages, for all or per spring
        gap.stiffness           | floats | 0.0  | N/m   | 0 ..       |
            stiffness of the second spring, likewise
        duffing.cubic           | floats | 0.0  | N/m^3 |            |
            coefficient of the deformation's cube, likewise; below 0 the spring softens up to its
            largest force
        """,
        "specimen",
    ),
)

_ACTUATOR = parameter_rows(
    """
    kind | string | servo_hydraulic |  | ideal, delay, servo_hydraulic, servo_hydraulic_linear |
        ideal and delay (Eq. 5.2) apply the reference force; servo_hydraulic obeys its valve,
        servo_hydraulic_linear is its small-signal limit
    delay                | float  | 0.0       | s        | 0 .. 10 | delay of kind delay
    oil_stiffness        | floats | 0.0       | N/m      | 0 ..    |
        stiffness of the oil column; 0: 4 beta A^2 / V
    oil_column_frequency | floats | 0.0       | Hz       | 0 ..    |
        resonance of the specimen's mass on the oil column, in place of oil_stiffness; 0: not given
    flow_gain            | floats | 0.0       | m/s/V    | 0 ..    |
        piston velocity for one volt; 0: from the rated flow
    leakage              | floats | 0.0       | 1/s      | 0 ..    | leakage rate; 0: 4 beta C / V
    force_capacity       | floats | 0.0       | N        | 0 ..    |
        force without flow; 0: supply_pressure * piston_area
    piston_area          | floats | 1.1836e-3 | m^2      | > 0     | net area of the piston, A
    supply_pressure      | floats | 20.7e6    | Pa       | > 0     | supply pressure
    rated_flow           | floats | 2.754e-4  | m^3/s    | > 0     |
        flow of the open valve at rated_pressure_drop
    rated_pressure_drop  | floats | 6.9e6     | Pa       | > 0     | pressure drop of rated_flow
    rated_voltage        | floats | 10.0      | V        | > 0     |
        drive at which the valve is fully open
    bulk_modulus         | floats | 0.7e9     | Pa       | > 0     |
        effective bulk modulus of oil, air and hoses, beta
    oil_volume           | floats | 2.357e-4  | m^3      | > 0     |
        oil under compression, both chambers, V
    leakage_coefficient  | floats | 4.2e-12   | m^3/s/Pa | 0 ..    |
        leakage flow per load pressure, C
    valve_frequency      | floats | 70.0      | Hz       | > 0     | natural frequency of the valve
    valve_damping        | floats | 0.6       |          | > 0     | damping ratio of the valve
    dead_time            | float  | 0.001     | s        | 0 .. 1  | dead time of the valve
    friction             | floats | 0.0       | N        | 0 ..    | Coulomb friction of the piston
    friction_velocity    | floats | 0.005     | m/s      | > 0     |
        velocity over which Coulomb friction builds up
    viscous_friction     | floats | 0.0       | N s/m    | 0 ..    | viscous friction of the piston
    stroke               | floats | 0.076     | m        | > 0     |
        displacement in both directions at which the piston meets its stops
    """,
    "actuator",
)
"""Identified values are used if given, otherwise the data sheets; their defaults are those of the
paper's rig (docs/rig.md)."""

SENSORS = parameter_rows(
    """
    position_scale      | floats | 1.0   |       |         | measured over true displacement
    velocity_scale      | floats | 1.0   |       |         | measured over true velocity
    acceleration_scale  | floats | 1.0   |       |         | measured over true acceleration
    force_scale         | floats | 1.0   |       |         | measured over true force
    tilt                | floats | 0.0   |       |         |
        accelerations that the accelerometers show per acceleration of each axis, a matrix row by
        row; 0: each shows its own axis alone
    position_lag        | floats | 0.0   | s     | 0 .. 1  |
        time by which the measured displacement is late, in whole samples or not
    velocity_lag        | floats | 0.0   | s     | 0 .. 1  | of the measured velocity, likewise
    acceleration_lag    | floats | 0.0   | s     | 0 .. 1  | of the measured acceleration, likewise
    force_lag           | floats | 0.0   | s     | 0 .. 1  | of the measured force, likewise
    position_filter     | floats | 0.0   | Hz    | 0 ..    |
        cut-off of the displacement's filter (Butterworth, second order); 0: none
    velocity_filter     | floats | 0.0   | Hz    | 0 ..    | of the velocity's filter, likewise
    acceleration_filter | floats | 0.0   | Hz    | 0 ..    | of the acceleration's filter, likewise
    force_filter        | floats | 0.0   | Hz    | 0 ..    | of the force's filter, likewise
    position_noise     | floats | 0.0   | m     | 0 ..    | RMS noise of displacement
    velocity_noise     | floats | 0.0   | m/s   | 0 ..    | RMS noise of velocity
    acceleration_noise | floats | 0.0   | m/s^2 | 0 ..    | RMS noise of acceleration
    force_noise        | floats | 0.0   | N     | 0 ..    | RMS noise of force
    position_bias      | floats | 0.0   | m     |         | constant error of displacement
    velocity_bias      | floats | 0.0   | m/s   |         | constant error of velocity
    acceleration_bias  | floats | 0.0   | m/s^2 |         | constant error of acceleration
    force_bias         | floats | 0.0   | N     |         | constant error of force
    position_range     | floats | 0.0   | m     | 0 ..    |
        displacement in both directions at which the sensor saturates; 0: never
    velocity_range     | floats | 0.0   | m/s   | 0 ..    |
        velocity in both directions at which the sensor saturates; 0: never
    acceleration_range | floats | 0.0   | m/s^2 | 0 ..    |
        acceleration in both directions at which the sensor saturates; 0: never
    force_range        | floats | 0.0   | N     | 0 ..    |
        force in both directions at which the sensor saturates; 0: never
    adc_bits           | int    | 0     |       | 0 .. 32 |
        bits of the analog-digital converter over each range; 0: exact
    velocity | string | measured |  | measured, derived |
        measured, or derived from the measured displacement by a filtered derivative
    velocity_cutoff    | float  | 100.0 | Hz    | > 0     | cut-off of that derivative
    """,
    "sensors",
)

CALIBRATION = parameter_rows(
    """
    position_scale     | floats | 1.0   |       |         |
        what is known of the measured displacement: measured over true change
    velocity_scale     | floats | 1.0   |       |         | of the velocity, likewise
    acceleration_scale | floats | 1.0   |       |         | of the acceleration, likewise
    force_scale        | floats | 1.0   |       |         | of the force, likewise
    tilt               | floats | 0.0   |       |         |
        what is known of what the accelerometers show per acceleration of each axis, a matrix row
        by row; 0: each shows its own axis alone
    position_lag       | floats | 0.0   | s     | 0 .. 1  |
        time by which the measured displacement is known to be late. All channels are aligned to
        the latest one, and the loop counts its lag
    velocity_lag       | floats | 0.0   | s     | 0 .. 1  | of the velocity, likewise
    acceleration_lag   | floats | 0.0   | s     | 0 .. 1  | of the acceleration, likewise
    force_lag          | floats | 0.0   | s     | 0 .. 1  | of the force, likewise
    position_zero      | floats | 0.0   | m     |         | measured displacement at a true one of 0
    velocity_zero      | floats | 0.0   | m/s   |         | measured velocity at a true one of 0
    acceleration_zero  | floats | 0.0   | m/s^2 |         | measured acceleration at a true one of 0
    force_zero         | floats | 0.0   | N     |         | measured force at a true one of 0
    zeroing            | float  | supervisor:rehearsal.zeroing or 1.0 | s | 0 .. 60 |
        time at rest before a test in which the simulated rig measures the zeros that are 0 here;
        0: it does not
    """,
    "calibration",
)
"""What a rig, simulated or not, takes out of its samples: `calibration.calibration_of`."""

SAFETY = parameter_rows(
    """
    limits.command | float | force_controller:voltage_limit or 10.0 | V | > 0 |
        largest valve command, in both directions, that the rig applies; a larger one is refused.
        Idealised actuators refuse a reference force beyond limits.force instead
    safe.valve_command          | floats | 0.0  | V |         |
        valve command after the end of a test; an idealised actuator removes its force instead
    safe.close_time             | float  | 0.02 | s | 0 .. 1  |
        time in which the valve goes from the last command to safe.valve_command. Longer than a
        period of the oil column, because a valve that closes at once on a mass M with velocity v
        makes a force peak of v sqrt(k_oil M); shorter than a sixth of the specimen's period,
        because the specimen still moves
    safe.settle_time            | float  | 0.2  | s | 0 .. 60 |
        longest time for which the simulated rig continues after that, until it is at rest; 0: not
        at all
    watchdog.command_timeout | float | supervisor:watchdog.command_timeout or 0.02 | s | > 0 |
        in realtime: longest time without a new command before the rig trips
    watchdog.supervisor_timeout | float  | 1.0  | s | > 0     |
        longest silence of the supervisor before the rig trips
    """
)

RIG_TABLE = Table(
    "rig",
    [
        *_PACE,
        _FAULTS,
        *SPECIMEN,
        *SPRINGS,
        *_ACTUATOR,
        *SENSORS,
        *CALIBRATION,
        *limit_rows(default_from="supervisor"),
        *SAFETY,
        *host.REALTIME_PARAMETERS,
    ],
)
