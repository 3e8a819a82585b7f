"""Nodes of the loop in one process, for rates that separate processes can't hold.

    ros2 run seft_ros loop --nodes rig reference_force --ros-args --params-file FILE

They are the same nodes as the separate executables, with the same names, topics, parameters and
bits. They pass their messages to each other directly; all others receive them on the topics.
"""

import argparse
import sys

from seft_msgs_py.node.node_kind import NodeKind, run_nodes
from seft_msgs_py.printing import unbroken
from seft_plant_sim.rig_node import RIG_NODE as RIG

from seft_ros.nodes.force_controller_node import FORCE_CONTROLLER_NODE as FORCE_CONTROLLER
from seft_ros.nodes.reference_force_node import REFERENCE_FORCE_NODE as REFERENCE_FORCE

_KINDS: dict[str, NodeKind] = {
    kind.table.node: kind for kind in (RIG, REFERENCE_FORCE, FORCE_CONTROLLER)
}
"""The rig comes first: it is the clock, and spins for all."""


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
        "--nodes", nargs="+", choices=_KINDS, default=list(_KINDS), help="default: all of them"
    )
    words = sys.argv[1:]
    ros = words.index("--ros-args") if "--ros-args" in words else len(words)
    wanted = parser.parse_args(words[:ros]).nodes
    return run_nodes(*(kind for node, kind in _KINDS.items() if node in wanted))


if __name__ == "__main__":
    sys.exit(main())
