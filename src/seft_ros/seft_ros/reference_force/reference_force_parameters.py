"""Parameter table of the reference force, the methods by name, and the content of its topic.

The import of the methods themselves takes a third of a second; most nodes do not need it.
"""

import math
from collections.abc import Mapping
from typing import Any

from seft_msgs_py.config.facts import SETTINGS, facts
from seft_msgs_py.config.parameter_table import Table, parameter_rows
from seft_msgs_py.config.registered import Registered
from seft_msgs_py.node import host
from seft_msgs_py.wire.topics import REFERENCE_FORCE, TARGET, LoopTopic
from seft_plant_sim.rig_parameters import MASS_RATIO_ROWS, common_lag

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
        seft: with computed mass, by acceleration feedback (Eq. 2.5); eft: without (Eq. 2.3), the
        specimen has all of the mass
    computed.mass      | floats | 0.0  | kg    |           |
        mass of the computed substructure over the axes, then its internal degrees of
        freedom: one number, a diagonal, or a matrix; 0: specimen.mass
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
    """
)
_COMPENSATION = parameter_rows(
    """
    compensation.horizon               | float  | 0.05  | s     | > 0 .. 1  |
        `target_motion`: how far ahead the motion is predicted; four times the delay of the
        valves, or three times that of the force loop; four times the lag of the sensors is added
    instability.ratio                  | float  | 5.0   |       | 0 ..      |
        ratio of the vibration to that of the structure under the measured restoring force, above
        which the test is ramped down, before a limit is reached; 0: never
    instability.floor                  | float  | 0.3   | m/s^2 | > 0       |
        least vibration (RMS) that is assumed for the structure: several times the noise of
        the accelerometers
    instability.lowest                 | float  | 0.0   | Hz    | 0 ..      |
        lowest frequency at which vibration is watched; 0: twice the specimen's lowest natural
        frequency
    watchdog.rig_timeout               | float  | 0.01  | s     | > 0       |
        with several rigs in realtime: longest time that the state of one rig may be missing
        after another's has arrived, before the test trips
    ramp_down_time                     | float  | 0.5   | s     | > 0 .. 60 |
        time of the test in which a ramp-down takes the reference force to zero, as half a
        cosine
    """
)
SETTINGS_OF_THE_TEST = [row for row in (*MASS_RATIO_ROWS, *_COMPENSATION) if row.name in SETTINGS]
"""Those that the force controller uses, too."""
REFERENCE_FORCE_TABLE = Table(
    "reference_force",
    [
        *facts("loop_delay", "specimen.", "sensors.", "limits.force", "limits.force_rate"),
        *facts("actuator.kind", "actuator.delay", "actuator.response.", "calibration."),
        *_TEST[:1],
        *MASS_RATIO_ROWS,
        *_TEST[1:],
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


def horizon_steps(section: Mapping[str, Any], dt: float) -> int:
    """Count the steps by which a target is predicted.

    Parameters
    ----------
    section : mapping
        With ``compensation.horizon`` and the lags of the sensors, s.
    dt : float
        Sampling period, s.
    """
    horizon = section["compensation.horizon"] + HORIZON_PER_LAG * common_lag(section)
    return math.ceil(horizon / dt - 1e-9)


def reference_force_topic(section: Mapping[str, Any]) -> LoopTopic:
    """Give the topic from the reference force's section of an experiment.

    Without that section a reader uses `REFERENCE_FORCE`, which also reads the force of a target.
    """
    is_target = section.get("compensation.method") == TARGET_MOTION
    return TARGET if is_target else REFERENCE_FORCE
