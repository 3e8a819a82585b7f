"""Parameter table of the reference force, the methods by name, and the content of its topic.

The import of the methods themselves takes a third of a second; most nodes do not need it.
"""

import math
from collections.abc import Mapping
from typing import Any

from seft_msgs_py.config.parameter_table import Table, parameter_rows
from seft_msgs_py.config.registered import Registered
from seft_msgs_py.node import host
from seft_msgs_py.wire.topics import REFERENCE_FORCE, TARGET, LoopTopic

TARGET_MOTION = "target_motion"
OWN_METHODS = ("none", "model", "restoring", TARGET_MOTION)
OF_MODEL = "computed "
"""Prefix of the names of a computed model's recorded values."""
LONGEST_MODEL_STEP = 0.05
"""s, of a computed model: by then the rig has held its command too long."""
REGISTERED_METHODS = Registered("seft.compensation", OWN_METHODS)
"""Methods of other packages: name -> `compensator.Method`, which may take settings."""

_TEST = parameter_rows(
    """
    method             | string | seft |       | eft, seft |
        seft: with computed mass, by acceleration feedback (Eq. 2.5); eft: without (Eq. 2.3)
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
        ground acceleration of each internal degree of freedom per ground acceleration of each
        axis, row by row; 0: that of the first axis. With target_motion, rows of the axes may
        precede: 0 for an axis that is a deformation above an internal degree of freedom
    computed.model     | string |      |       |           |
        computed model, for target_motion: FILE.py:CLASS, MODULE:CLASS or a name that a
        package has registered, e.g. opensees (docs/computed_models.md); empty: no model
    computed.settings  | string |      |       |           |
        its settings, e.g. script=frame.py substeps=2
    computed.every     | int    | 1    |       | 1 .. 50   |
        samples from one step of the model to the next; above 1 for a slow model
    loop_delay         | int    | 0    |       | -1 .. 100 |
        steps from a state to the first use of the force that is computed from it, if there is
        a link between this node and the force controller (docs/hosts.md); 0: no link, and the
        force controller waits for the force; -1: seft run measures it before the test
    model.mass         | floats | rig:specimen.mass | kg    |           |
        assumed mass of the specimen
    model.damping      | floats | rig:specimen.damping or 0.0 | N s/m |           |
        assumed damping of the specimen
    model.stiffness    | floats | rig:specimen.stiffness | N/m   |           |
        assumed stiffness of the specimen
    identified.mass    | floats | 0.0 | kg    | |
        mass of the specimen as seft identify --specimen finds it, likewise; what a test says of
        its own mass is combined with it
    identified.mass_error | floats | 0.0 | kg | 0 .. |
        its standard error on each axis; 0: not identified
    identified.force_lag_error | floats | 0.0 | s | 0 .. |
        standard error of the lag of the force behind the acceleration, likewise
    model.springs      | floats | rig:specimen.springs or 0.0 |       |           |
        springs of the specimen that may yield: deformation of each spring per displacement of
        each axis; 0: one spring between each axis and the ground
    """
)
_COMPENSATION = parameter_rows(
    """
    compensation.delay                 | float  | 0.0   | s     | 0 .. 1    |
        delay that the method compensates: from reference force to measured force, with the
        latency of the loop, as seft identify finds it (for an idealised actuator its delay plus
        1.5 steps, without compensation.sensor_lag); `none` and `restoring` do not use it
    compensation.sensor_lag | float | rig:calibration.*_lag or 0.0 | s | 0 .. 1 |
        lag of the measured state, that of the rig's latest channel, to which the others are
        aligned. It adds to the horizon, and to the delay or dead time of an idealised actuator. A
        force loop with feedback has the same delay at low frequency with and without it
    compensation.actuator_kind | string | rig:actuator.kind or servo_hydraulic |  | ideal, delay,
        servo_hydraulic, servo_hydraulic_linear | `target_motion`: kind of the rig's
        actuators; ideal and delay obey reference_force, which is then sent ahead of time, by
        their response (tracking.*)
    compensation.horizon               | float  | 0.05  | s     | > 0 .. 1  |
        `target_motion`: how far ahead the motion is predicted; four times the delay of the
        valves, or three times that of the force loop; four times compensation.sensor_lag is added
    compensation.noise.position | floats | rig:sensors.position_noise or 0.0 | m | 0 .. |
        RMS noise of the measured displacement, which determines its weight
    compensation.noise.velocity | floats | rig:sensors.velocity_noise or 0.0 | m/s | 0 .. |
        RMS noise of the measured velocity, which determines its weight
    compensation.noise.acceleration | floats | rig:sensors.acceleration_noise or 0.0 | m/s^2 | 0 ..
        | RMS noise of the measured acceleration, which determines its weight
    compensation.noise.force | floats | rig:sensors.force_noise or 0.0 | N | 0 .. |
        RMS noise of the measured force, which determines its weight
    compensation.noise.velocity_source | string | rig:sensors.velocity or measured |  | measured,
        derived | whether the velocity is measured, or derived from the displacement (and
        therefore late)
    tracking.numerator                 | floats | [0.0] |       |           |
        numerator of the identified response from reference force to measured force of the
        same step, in s, highest power first, for `target_motion` on a rig that obeys forces;
        0: a pure delay, of compensation.delay
    tracking.denominator               | floats | [1.0] |       |           |
        its denominator, likewise
    tracking.dead_time                 | float  | 0.0   | s     | 0 .. 1    |
        its dead time, with the loop's latency and, of an idealised actuator, without
        compensation.sensor_lag
    limits.force | float | supervisor:limits.force or 22200.0 | N | > 0 |
        largest reference force on any axis; beyond it the test is ramped down
    limits.force_rate                  | float  | 0.0   | N/s   | 0 ..      |
        fastest change of the reference force on any axis within 2 ms, or one step if that is
        longer, likewise; 0: limits.force within 2 ms, so that it finds faults only
    instability.ratio                  | float  | 5.0   |       | 0 ..      |
        ratio of the vibration to that of the structure under the measured restoring force, above
        which the test is ramped down, before a limit is reached; 0: never
    instability.floor                  | float  | 0.3   | m/s^2 | > 0       |
        least vibration (RMS) that is assumed for the structure: several times the noise of
        the accelerometers
    instability.lowest                 | float  | 0.0   | Hz    | 0 ..      |
        lowest frequency at which vibration is watched; 0: twice the specimen's lowest natural
        frequency, from the model
    watchdog.rig_timeout               | float  | 0.01  | s     | > 0       |
        with several rigs in realtime: longest time that the state of one rig may be missing
        after another's has arrived, before the test trips
    ramp_down_time                     | float  | 0.5   | s     | > 0 .. 60 |
        time of the test in which a ramp-down takes the reference force to zero, as half a
        cosine
    """
)
REFERENCE_FORCE_TABLE = Table(
    "reference_force",
    [
        *_TEST,
        REGISTERED_METHODS.row(
            "compensation.method", "none", "how the actuator's delay is compensated"
        ),
        REGISTERED_METHODS.settings_row("compensation.settings", "a method"),
        *_COMPENSATION,
        *host.REALTIME_PARAMETERS,
    ],
)


HORIZON_PER_LAG = 4.0
"""Part of the horizon for the lag of the measured state, over that lag, as for the valve's."""


def horizon_steps(horizon: float, sensor_lag: float, dt: float) -> int:
    """Count the steps by which a target is predicted.

    Parameters
    ----------
    horizon, sensor_lag : float
        ``compensation.horizon`` and ``compensation.sensor_lag``, s.
    dt : float
        Sampling period, s.
    """
    return math.ceil((horizon + HORIZON_PER_LAG * sensor_lag) / dt - 1e-9)


def reference_force_topic(section: Mapping[str, Any]) -> LoopTopic:
    """Give the topic from the reference force's section of an experiment.

    Without that section a reader uses `REFERENCE_FORCE`, which also reads the force of a target.
    """
    is_target = section.get("compensation.method") == TARGET_MOTION
    return TARGET if is_target else REFERENCE_FORCE
