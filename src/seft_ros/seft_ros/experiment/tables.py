"""Parameter tables of all nodes, in the order of the signal's way."""

from seft_plant_sim.rig_parameters import TABLE as RIG

from seft_ros.experiment.watching import RECORDER, SUPERVISOR
from seft_ros.force_controller.parameters import TABLE as FORCE_CONTROLLER
from seft_ros.ground_motion.parameters import TABLE as GROUND_MOTION
from seft_ros.reference_force.reference_force_parameters import TABLE as REFERENCE_FORCE

TABLES = (GROUND_MOTION, REFERENCE_FORCE, FORCE_CONTROLLER, RIG, SUPERVISOR, RECORDER)
