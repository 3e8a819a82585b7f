"""Nodes of the loop in one process, for rates that separate processes can't hold.

    ros2 run seft_ros loop --nodes rig reference_force --ros-args --params-file FILE

They are the same nodes as the separate executables, with the same names, topics, parameters and
bits. They pass their messages to each other directly; all others receive them on the topics.
"""

import argparse
import sys

from seft_msgs_py.node.node_shell import NodeKind, run_nodes
from seft_msgs_py.printing import unbroken
from seft_msgs_py.wire.topics import LOOP_NODES
from seft_plant_sim.rig_node import RIG_NODE as RIG

from seft_ros.nodes.force_controller_node import FORCE_CONTROLLER_NODE as FORCE_CONTROLLER
from seft_ros.nodes.ground_motion_node import GROUND_MOTION_NODE as GROUND_MOTION
from seft_ros.nodes.recorder_node import RECORDER_NODE as RECORDER
from seft_ros.nodes.reference_force_node import REFERENCE_FORCE_NODE as REFERENCE_FORCE
from seft_ros.nodes.supervisor_node import SUPERVISOR_NODE as SUPERVISOR

NODE_KINDS: dict[str, NodeKind] = {
    kind.table.node: kind
    for kind in (GROUND_MOTION, REFERENCE_FORCE, FORCE_CONTROLLER, RIG, SUPERVISOR, RECORDER)
}
"""All nodes of a test, by name."""


def main() -> int:
    """Entry point of ``ros2 run seft_ros loop``."""
    return unbroken("loop", _main)


def _main() -> int:
    parser = argparse.ArgumentParser(
        prog="loop",
        description="Nodes of the loop in one process, with topics and bits as in several.",
        epilog="ROS arguments follow --ros-args, as for every node.",
    )
    parser.add_argument(
        "--nodes", nargs="+", choices=LOOP_NODES, default=LOOP_NODES, help="default: all of them"
    )
    words = sys.argv[1:]
    ros = words.index("--ros-args") if "--ros-args" in words else len(words)
    wanted = parser.parse_args(words[:ros]).nodes
    return run_nodes(*(NODE_KINDS[node] for node in LOOP_NODES if node in wanted))


if __name__ == "__main__":
    sys.exit(main())
