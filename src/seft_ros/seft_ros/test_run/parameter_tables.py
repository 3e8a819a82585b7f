"""Parameter tables of all nodes; those of supervisor and recorder are written here."""

from dataclasses import replace

from seft_msgs_py.config.facts import facts
from seft_msgs_py.config.parameter_table import Parameter, Table, parameter_rows
from seft_msgs_py.wire.topics import NODES
from seft_plant_sim.rig_parameters import RIG_TABLE as RIG

from seft_ros.force_controller.force_controller_parameters import (
    FORCE_CONTROLLER_TABLE as FORCE_CONTROLLER,
)
from seft_ros.ground_motion.ground_motion_block import GROUND_MOTION_TABLE as GROUND_MOTION
from seft_ros.reference_force.reference_force_parameters import (
    REFERENCE_FORCE_TABLE as REFERENCE_FORCE,
)
from seft_ros.test_run.peers import REHEARSAL_PARAMETERS as REHEARSAL

_WATCHDOG = parameter_rows(
    """
    watchdog.peer_timeout    | float | 1.0  | s | > 0 0.5 .. |
        longest silence of a node before the test trips; a node sends a sign of life 5 times
        a second
    watchdog.ramp_margin     | float | 2.0  | s | > 0        |
        longest time that the reference force may take beyond its ramp_down_time before the
        test trips at once; ten times as long in lockstep, where steps may take any time
    watchdog.missed_share    | float | 0.05 |   | 0 .. 1     |
        largest share of the steps of a second, whichever, that may miss their command, before the
        test is ramped down; 1: any
    """
)
SUPERVISOR_TABLE = Table(
    "supervisor",
    [
        *facts("limits.", "calibration.zeroing"),
        *_WATCHDOG,
        *REHEARSAL,
        Parameter(
            "peers",
            "strings",
            [node for node in NODES if node != "supervisor"],
            "nodes that a test needs",
            choices=tuple(node for node in NODES if node != "supervisor"),
        ),
    ],
)

_LIVE = parameter_rows(
    """
    directory | string | bags |  |               | folder in which a test's bag is made
    name      | string |      |  | a file's name |
        name of the bag in it; empty: date and time of the start
    on_loss   | string | stop |  | stop, go_on   |
        what happens to a test if its bag is deleted or moved, or writing fails: the test is
        ramped down, or continues; the recorder keeps all messages, and saves them at the end
    """
)
RECORDER_TABLE = Table("recorder", [*facts(), *(replace(row, live=True) for row in _LIVE)])

TABLES = (GROUND_MOTION, REFERENCE_FORCE, FORCE_CONTROLLER, RIG, SUPERVISOR_TABLE, RECORDER_TABLE)
