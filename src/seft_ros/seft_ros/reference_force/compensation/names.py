"""Names of the compensation methods, for nodes that know their parameters but not the methods.

What the methods compute with takes a third of a second to import.
"""

NAMES = (
    "none",
    "polynomial",
    "linear_acceleration",
    "model",
    "smith",
    "inverse",
    "ats",
    "restoring",
    "preview_inverse",
)
