"""Parameter table of the reference force, the methods by name, and what its topic carries.

The methods themselves take a third of a second to import, which most nodes can do without.
"""

from collections.abc import Mapping
from typing import Any

from seft_msgs_py.config.parameter_table import Parameter, Table, parameter_rows
from seft_msgs_py.config.registered import Registered
from seft_msgs_py.node import realtime
from seft_msgs_py.wire.topics import REFERENCE_FORCE, TARGET, LoopTopic

TARGET_MOTION = "target_motion"
OWN = (
    "none",
    "polynomial",
    "linear_acceleration",
    "model",
    "smith",
    "inverse",
    "ats",
    "restoring",
    TARGET_MOTION,
)
OF_MODEL = "computed "
"""Begins the names of what is recorded of a computed model."""
REGISTERED = Registered("seft.compensation", OWN)
"""Of other packages: name of a method -> `compensator.Method`, which may take settings."""

_TEST = parameter_rows(
    """
    method             | string | seft |       | eft, seft |
        seft: computed mass by acceleration feedback (Eq. 2.5); eft: without (Eq. 2.3)
    mass_ratio         | float  | 0.0  |       | 0 ..      |
        computed mass over specimen mass, alpha; with computed.mass a factor on all that is
        computed, 1 as given
    computed.mass      | floats | 0.0  | kg    |           |
        mass of the computed substructure over the axes, then its internal degrees of
        freedom: one number, a diagonal, or a matrix; 0: the mass of the specimen's model
    computed.damping   | floats | 0.0  | N s/m |           | its damping, likewise
    computed.stiffness | floats | 0.0  | N/m   |           | its stiffness, likewise
    computed.internal  | int    | 0    |       | 0 .. 200  |
        degrees of freedom of the computed substructure beside the axes
    computed.influence | floats | 0.0  |       |           |
        ground acceleration of each of these per that of each axis, one after the other; 0:
        that of the first axis; with target_motion, those of the axes may stand before: 0
        where an axis is a deformation on top of an internal degree of freedom
    computed.model     | string |      |       |           |
        what else is computed, for target_motion: FILE.py:CLASS, MODULE:CLASS or a name
        that a package has registered, as opensees (docs/computed_models.md); empty:
        nothing
    computed.settings  | string |      |       |           |
        its settings, as script=frame.py substeps=2
    computed.every     | int    | 1    |       | 1 .. 50   |
        samples from one step of the model to the next, where it is slow
    loop_delay         | int    | 0    |       | -1 .. 100 |
        steps from a state to the first use of the force that is computed from it, where a
        link lies between this node and the force controller (docs/hosts.md); 0: none does,
        and the force controller waits for it; -1: seft run measures it before the test
    model.mass         | floats | rig:specimen.mass | kg    |           |
        mass of the specimen as known to the experimenter
    model.damping      | floats | rig:specimen.damping or 0.0 | N s/m |           |
        damping of the specimen, likewise
    model.stiffness    | floats | rig:specimen.stiffness | N/m   |           |
        stiffness of the specimen, likewise
    model.springs      | floats | rig:specimen.springs or 0.0 |       |           |
        springs of the specimen that may yield, likewise: deformation of each per
        displacement of each axis; 0: one between each axis and the ground
    """
)
_COMPENSATION = parameter_rows(
    """
    compensation.delay                 | float  | 0.0   | s     | 0 .. 1    |
        delay that the method compensates: from reference force to measured force, latency
        of the loop included, as seft identify finds it (an idealised actuator's delay and
        1.5 steps); `none` and `restoring` do not use it
    compensation.order                 | int    | 1     |       | 1 .. 3    |
        order of the polynomial of `polynomial`
    compensation.estimate_delay        | bool   | false |       |           |
        estimate the delay of each axis while the test runs, from compensation.delay on; for
        the methods that compensate a delay, `ats` adapts by itself
    compensation.delay_range           | floats | [0.002, 0.04] | s     | 0 .. 0.1  |
        shortest and longest delay that is estimated
    compensation.delay_rate            | float  | 0.01  |       | 0 ..      |
        largest change of an estimated delay, s per s
    compensation.excitation            | float  | 20.0  | N     | > 0       |
        RMS of the forces over about a second from which on they are used to adapt; above
        what the sensors' noise makes
    compensation.band                  | floats | [1.0, 12.0] | Hz    | > 0       |
        lowest and highest frequency at which forces are compared to adapt: where they have
        their energy
    compensation.actuator_kind | string | rig:actuator.kind or servo_hydraulic |  | ideal, delay,
        servo_hydraulic, servo_hydraulic_linear | `target_motion`: kind of the rig's
        actuators; ideal and delay are driven by reference_force, which is then sent ahead
        by their response (tracking.*)
    compensation.horizon               | float  | 0.05  | s     | > 0 .. 1  |
        `target_motion`: time ahead for which the motion is predicted; four times the
        delay of the valves, or three times that of the force loop
    compensation.noise.position | floats | rig:sensors.position_noise or 0.0 | m | 0 .. |
        RMS noise of the measured displacement, by which it is weighed against the others
    compensation.noise.velocity | floats | rig:sensors.velocity_noise or 0.0 | m/s | 0 .. |
        RMS noise of the measured velocity, by which it is weighed against the others
    compensation.noise.acceleration | floats | rig:sensors.acceleration_noise or 0.0 | m/s^2 | 0 ..
        | RMS noise of the measured acceleration, by which it is weighed against the others
    compensation.noise.force | floats | rig:sensors.force_noise or 0.0 | N | 0 .. |
        RMS noise of the measured force, by which it is weighed against the others
    compensation.noise.velocity_source | string | rig:sensors.velocity or measured |  | measured,
        derived | whether the velocity is measured, or derived from the displacement and so
        late
    tracking.numerator                 | floats | [0.0] |       |           |
        numerator of the identified response from reference force to measured force of the
        same step, in s, highest power first, for `target_motion` on a rig that is driven by
        forces; 0: a pure delay, of compensation.delay
    tracking.denominator               | floats | [1.0] |       |           |
        its denominator, likewise
    tracking.dead_time                 | float  | 0.0   | s     | 0 .. 1    |
        its dead time, the loop's latency included
    limits.force | float | supervisor:limits.force or 22200.0 | N | > 0 |
        largest reference force on any axis; beyond it the test is ramped down
    limits.force_rate                  | float  | 3.0e6 | N/s   | > 0       |
        fastest change of the reference force on any axis from step to step, likewise; far
        above what a test near its limits asks for, so that it only catches what is no test
    instability.ratio                  | float  | 5.0   |       | 0 ..      |
        vibration beyond this many times what the structure has under the measured restoring
        force brings the test down softly, before it grows to a limit; 0: never
    instability.floor                  | float  | 0.3   | m/s^2 | > 0       |
        vibration (RMS) that counts as the structure's in any case: several times the noise
        of the accelerometers
    instability.lowest                 | float  | 0.0   | Hz    | 0 ..      |
        frequency from which on vibration is watched; 0: twice the specimen's lowest natural
        frequency, which the model gives
    watchdog.rig_timeout               | float  | 0.01  | s     | > 0       |
        of several rigs in realtime: longest time that the state of one may fail to come
        when another's is there, before the test trips
    ramp_down_time                     | float  | 0.5   | s     | > 0 .. 60 |
        experiment time in which the reference force goes to zero, as half a cosine, where a
        test is brought down softly
    """
)
TABLE = Table(
    "reference_force",
    [
        *_TEST,
        Parameter(
            "compensation.method",
            "string",
            "none",
            "how the measured acceleration is freed of the actuator's delay",
            choices=REGISTERED.names,
        ),
        REGISTERED.settings_row("compensation.settings", "a method"),
        *_COMPENSATION,
        *realtime.PARAMETERS,
    ],
)


def reference_force_topic(section: Mapping[str, Any]) -> LoopTopic:
    """Give the topic as the reference force's section of an experiment makes it.

    Whoever does not know that section reads it as `REFERENCE_FORCE`: the force of a target, too.
    """
    is_target = section.get("compensation.method") == TARGET_MOTION
    return TARGET if is_target else REFERENCE_FORCE
