"""All nodes of a test, by name."""

from seft_msgs_py.node.node_kind import NodeKind
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
