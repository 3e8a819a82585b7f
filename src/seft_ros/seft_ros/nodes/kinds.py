"""All nodes of a test, by name."""

from seft_msgs_py.node.node_kind import NodeKind
from seft_plant_sim.rig_node import KIND as RIG

from seft_ros.nodes.force_controller_node import KIND as FORCE_CONTROLLER
from seft_ros.nodes.ground_motion_node import KIND as GROUND_MOTION
from seft_ros.nodes.recorder_node import KIND as RECORDER
from seft_ros.nodes.reference_force_node import KIND as REFERENCE_FORCE
from seft_ros.nodes.supervisor_node import KIND as SUPERVISOR

KINDS: dict[str, NodeKind] = {
    kind.table.node: kind
    for kind in (GROUND_MOTION, REFERENCE_FORCE, FORCE_CONTROLLER, RIG, SUPERVISOR, RECORDER)
}
