"""Parameter tables of the nodes that watch and record a test."""

from seft_msgs_py.config.parameter_table import Parameter, Table
from seft_msgs_py.wire.topics import NODES
from seft_plant_sim.rig.limits import limit_rows

SUPERVISOR = Table(
    "supervisor",
    [
        *limit_rows(),
        Parameter(
            "watchdog.command_timeout",
            "float",
            0.02,
            "longest time that rig and force controller go without each other in realtime: the "
            "rig without a new command, the force controller without a new state",
            "s",
            positive=True,
        ),
        Parameter(
            "watchdog.peer_timeout",
            "float",
            1.0,
            "longest silence of a node, which sends a sign of life 5 times a second, before the "
            "test trips",
            "s",
            positive=True,
            minimum=0.5,
        ),
        Parameter(
            "watchdog.ramp_margin",
            "float",
            2.0,
            "longest time that the reference force may take beyond its ramp_down_time before the "
            "test trips at once; ten times as long in lockstep, where the loop keeps no time",
            "s",
            positive=True,
        ),
        Parameter(
            "peers",
            "strings",
            [node for node in NODES if node != "supervisor"],
            "nodes that a test needs",
            choices=tuple(node for node in NODES if node != "supervisor"),
        ),
    ],
)

RECORDER = Table(
    "recorder",
    [
        Parameter("directory", "string", "bags", "folder in which a test's bag is made", live=True),
        Parameter(
            "name",
            "string",
            "",
            "name of the bag in it; empty: date and time of the start",
            live=True,
        ),
        Parameter(
            "storage",
            "string",
            "mcap",
            "file format of the bag",
            choices=("mcap", "sqlite3"),
            live=True,
        ),
    ],
)
