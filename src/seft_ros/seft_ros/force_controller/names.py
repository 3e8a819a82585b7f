"""Names of the force controllers, for nodes that know their parameters but not the controllers."""

from seft_msgs_py.config.registered import Registered

TRANSFER_FUNCTION = "transfer_function"
VELOCITY_FEEDFORWARD = "velocity_feedforward"
REGISTERED = Registered("seft.force_control", (TRANSFER_FUNCTION, VELOCITY_FEEDFORWARD))
"""Of other packages: name -> what makes a controller of `ControlKnowledge`; may take settings."""
