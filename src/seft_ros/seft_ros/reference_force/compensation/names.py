"""Names of the compensation methods, for nodes that know their parameters but not the methods.

What the methods compute with takes a third of a second to import. Those of other packages are
registered as entry points; none of their code is imported here.
"""

from importlib.metadata import entry_points

GROUP = "seft.compensation"
"""Group of the entry points: name of a method -> `compensator.Method`."""
OWN = (
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
REGISTERED = {entry.name: entry for entry in entry_points(group=GROUP) if entry.name not in OWN}
NAMES = (*OWN, *sorted(REGISTERED))
