"""Names of the force controllers, for nodes that know their parameters but not the controllers."""

from seft_msgs_py.registered import Registered

TRANSFER_FUNCTION = "transfer_function"
DECOUPLING = "decoupling"
REGISTERED = Registered("seft.force_control", (TRANSFER_FUNCTION, DECOUPLING))
"""Of other packages: name -> what makes a controller of `ControlKnowledge`; may take settings."""
