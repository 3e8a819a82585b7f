"""Names of the compensation methods, for nodes that know their parameters but not the methods.

What the methods compute with takes a third of a second to import.
"""

from seft_msgs_py.config.registered import Registered

TARGET_MOTION = "target_motion"
OWN = (
    "none",
    "polynomial",
    "linear_acceleration",
    "model",
    "smith",
    "inverse",
    "ats",
    "restoring",
    TARGET_MOTION,
)
REGISTERED = Registered("seft.compensation", OWN)
"""Of other packages: name of a method -> `compensator.Method`, which may take settings."""
