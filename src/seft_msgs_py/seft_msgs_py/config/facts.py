"""The facts of a test: what is known of its rig and specimen, once for all nodes.

In a file they stand under ``/**``; each node declares those that it uses, under the same names.
What the simulated rig truly is stands under ``rig: simulated.*``, and is the fact where it is not
given.
"""

from seft_msgs_py.config.parameter_table import Parameter, Value, parameter_rows

EVERY_NODE = "/**"
CHANNELS = ("displacement", "velocity", "acceleration", "force")
"""What a rig measures on each axis, in this order."""
FORCE_DRIVEN = ("ideal", "delay")
"""Kinds of actuators that obey a force; the others obey their valves."""
POSITION_SERVO = "position_servo"
"""Kind of actuators whose vendor's controller moves the valve: they obey a displacement."""


def command_unit(kind: str) -> str:
    """Give the unit of the commands of a force controller, by the kind of the actuators."""
    return "m" if kind == POSITION_SERVO else "V"


_LOOP = """
    rate | float   | 500.0 | Hz | > 0 .. 1e6 | sampling rate of the loop
    axes | strings | ["x"] |    |     |
        names of the axes (actuators), in order; RIG/AXIS if they belong to several rigs
    loop_delay | int | 0 | | -1 .. 100 |
        steps from a state to the first use of the force that is computed from it, over a link
        between reference_force and the rig (docs/hosts.md); 0: no link, each state is answered when
        its reference force has arrived; -1: seft run measures it before the test
"""

_SPECIMEN = """
    mass       | floats |     | kg    |  | mass: one number, a diagonal, or a matrix
    damping    | floats | 0.0 | N s/m |  | viscous damping, likewise
    stiffness  | floats |     | N/m   |  |
        initial elastic stiffness, likewise; without friction, and with open gaps
    springs    | floats | 0.0 |       |  |
        springs that may yield: deformation of each per displacement of each axis, spring by spring;
        0: one between each axis and the ground
    mass_error | floats | 0.0 | kg    | 0 .. |
        standard error of the mass on each axis, as seft identify --specimen finds it; 0: not known
"""

_ACTUATOR = """
    kind | string | servo_hydraulic |  | \
ideal, delay, servo_hydraulic, servo_hydraulic_linear, position_servo |
        ideal and delay (Eq. 5.2) obey the reference force; servo_hydraulic obeys its valve,
        servo_hydraulic_linear is its small-signal limit; position_servo obeys a displacement, by
        its vendor's controller: its commands are in m in place of V
    flow_gain       | floats | 0.0 | m/s/V | 0 .. | piston velocity for one volt; 0: not known
    oil_stiffness   | floats | 0.0 | N/m   | 0 .. | stiffness of the oil column; 0: not known
    leakage         | floats | 0.0 | 1/s   | 0 .. | rate at which the force decays by leakage
    force_capacity  | floats | 0.0 | N     | 0 .. |
        force at supply pressure; 0: not known, so that the load does not change the flow
    friction        | floats | 0.0 | N     | 0 .. |
        Coulomb friction of the piston, which the load cell does not measure
    friction_velocity | floats | 0.005 | m/s | > 0 | velocity over which it builds up
    valve_frequency | floats | 0.0 | Hz    | 0 .. | natural frequency of the valve; 0: not known
    valve_damping   | floats | 0.7 |       | 0 .. | damping ratio of the valve
    dead_time       | floats | 0.0 | s     | 0 .. 1 |
        dead time of the valve, without the loop's own step
    delay           | float  | 0.0 | s     | 0 .. 10 |
        delay from reference force to measured force, without the loop's 1.5 sampling periods: of
        kind delay, or of a force loop
    response.numerator   | floats | [0.0] |   |        |
        numerator of the response from reference force to measured force of the same step, in s,
        highest power first, as seft identify finds it; 0: a pure delay. Of a position_servo: from
        command to displacement, without the loop's step and hold
    response.denominator | floats | [1.0] |   |        | its denominator, likewise
    response.dead_time   | floats | 0.0   | s | 0 .. 1 |
        its dead time, without the lag of the sensors, and of forces with the loop's step. Of a
        position_servo one for each axis, too: numerator and denominator then have a polynomial for
        each
"""

_OF_A_CHANNEL = """
    sensors.{name}_noise     | floats | 0.0 | {unit} | 0 .. | RMS noise of the {name}; 0: not known
    sensors.{name}_range     | floats | 0.0 | {unit} | 0 .. |
        {name} in both directions at which the sensor saturates; 0: not known, or never
    calibration.{name}_per_volt | floats | 1.0 | {unit}/V | |
        {name} per volt, where the hardware reads volts; below 0 where the sensor stands the other
        way round; 1: it reads {unit}
    calibration.{name}_scale | floats | 1.0 |        |        | measured over true {name}
    calibration.{name}_bias  | floats | 0.0 | {unit} |        | measured {name} at a true one of 0
    calibration.{name}_lag   | floats | 0.0 | s      | 0 .. 1 |
        time by which the measured {name} is late; the channels are aligned to the latest one, whose
        lag the loop counts
    calibration.{name}_filter | floats | 0.0 | Hz | 0 .. |
        natural frequency of the low-pass of second order that the measured {name} has passed; 0:
        none. All channels get the response of the slowest one, whose delay the loop counts
    calibration.{name}_filter_damping | floats | 0.7071 | | > 0 |
        its damping ratio; 0.7071: Butterworth's
"""

_SENSORS = """
    velocity | string | measured | | measured, derived |
        measured, or derived from the displacement by a filtered derivative
    velocity_cutoff | float | 100.0 | Hz | > 0 | cut-off of that derivative
    acceleration | string | measured | | measured, derived |
        measured, or, of a position_servo, derived from the displacement and the target
    adc_bits | int | 0 | | 0 .. 32 |
        bits of the analog-digital converters over each range; 0: finer than the noise
"""

_CALIBRATION = """
    force_lag_error | floats | 0.0 | s | 0 ..    |
        standard error of the force's lag behind the acceleration; 0: not known
    force_scale_error | floats | 0.0 | | 0 ..   |
        standard error of the force's scale, relative, which no motion shows; 0: not known
    tilt            | floats | 0.0 |   |         |
        accelerations that the accelerometers show per acceleration of each axis, a matrix row by
        row; 0: each shows its own axis alone
    zeroing         | float  | 1.0 | s | 0 .. 60 |
        time at rest before a test in which the rig measures the biases that are 0 here; 0: none. A
        bias of more than a tenth of the channel's limit is refused
"""

# Rates are over 2 ms, `limits.RATE_SPAN`. Successful tests of config/jhu.yaml and config/demo.yaml
# reach 0.48, 26, 3e3 and 1.4e5; with valve and accelerometer driven into saturation 0.48, 51, 1.5e4
# and 6.5e5. An accelerometer's full range of 4 g at the oil column's 90 Hz is 2.2e4.
_LIMITS = """
    displacement      | float | 0.076   | m     | > 0  | largest displacement on any axis
    velocity          | float | 0.5     | m/s   | > 0  | largest velocity, likewise
    acceleration      | float | 98.1    | m/s^2 | > 0  | largest acceleration, likewise
    force             | float | 22200.0 | N     | > 0  |
        largest force on any axis, measured or reference force; beyond a limit the test trips
    displacement_rate | float | 3.0     | m/s   | > 0  |
        largest change of the measured displacement within 2 ms, or one sample if that is longer,
        per second; beyond it, as when a sensor or its cable breaks, the test trips
    velocity_rate     | float | 300.0   | m/s^2 | > 0  | of the velocity, likewise
    acceleration_rate | float | 3e4     | m/s^3 | > 0  | of the acceleration, likewise
    force_rate        | float | 0.0     | N/s   | 0 .. |
        of the force, measured or reference force, likewise; 0: limits.force within 2 ms
    saturated_time    | float | 0.05    | s     | 0 .. |
        longest time within one second that sensors may be saturated, before the test trips
    command           | float | 10.0    | V     | > 0  |
        largest valve command, in both directions. The rig refuses a larger one
"""

_GROUPS = {
    "": _LOOP,
    "specimen": _SPECIMEN,
    "actuator": _ACTUATOR,
    "sensors": _SENSORS,
    "calibration": _CALIBRATION,
    "limits": _LIMITS,
}
_UNITS = ("m", "m/s", "m/s^2", "N")
_BY_CHANNEL = (
    parameter_rows(_OF_A_CHANNEL.format(name=name, unit=unit))
    for name, unit in zip(CHANNELS, _UNITS, strict=True)
)
_BY_GROUP = (parameter_rows(text, name) for name, text in _GROUPS.items())
FACTS: dict[str, Parameter] = {row.name: row for rows in (*_BY_GROUP, *_BY_CHANNEL) for row in rows}
"""All facts, by name. Defaults of ``limits.*`` are those of the paper's rig."""

MATRICES = ("specimen.mass", "specimen.damping", "specimen.stiffness", "calibration.tilt")
BY_AXIS = [
    name
    for name, row in FACTS.items()
    if row.kind == "floats" and name not in (*MATRICES, "specimen.springs")
    if not name.startswith("actuator.response.")
]
"""Facts that have one value for all axes, or one for each."""

SETTINGS = {
    "mass_ratio": "reference_force",
    "ramp_down_time": "reference_force",
    "compensation.horizon": "reference_force",
    "safe.close_time": "rig",
    "detectors.warn_only": "rig",
    "watchdog.command_timeout": "rig",
}
"""Settings of a node that others use, too: name -> the node under which a file has them."""


def agree(name: str, one: Value, other: Value) -> bool:
    """Whether two nodes of a test may have these values of a fact; a number is one for each axis.

    Each keeps its own limits, the supervisor asks for zeroing, and one measures the loop's delay.
    """
    if one == other or name.startswith(("limits.", "calibration.zeroing")):
        return True
    lists = [value if isinstance(value, list) else [value] for value in (one, other)]
    numbers = [item for each in lists for item in each if isinstance(item, int | float)]
    if len(numbers) < sum(map(len, lists)):
        return False
    if name == "loop_delay":
        return min(numbers) < 0 < max(numbers)
    return 1 in map(len, lists) and len({*numbers}) == 1


def facts(*names: str) -> list[Parameter]:
    """Give rate, axes, and some facts for a node's table; ``specimen.`` is all of that group."""
    groups = tuple(name for name in names if name.endswith("."))
    chosen = {"rate", "axes", *names}
    return [row for name, row in FACTS.items() if name in chosen or name.startswith(groups)]


def place_of(name: str, node: str) -> str:
    """Say where a file has a node's parameter: under `EVERY_NODE`, this node, or another one."""
    return EVERY_NODE if name in FACTS else SETTINGS.get(name, node)


def fact_of(name: str) -> str:
    """Give the fact that is the default of a parameter ``simulated.*``; empty if there is none."""
    known = name.removeprefix("simulated.")
    of_channel = known.replace("sensors.", "calibration.")
    found = [fact for fact in (known, of_channel) if fact in FACTS and fact != name]
    return found[0] if found else ""
