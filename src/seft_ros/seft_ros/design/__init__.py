"""Design of a test: identification of the rig, preflight."""

from enum import StrEnum


class PlantSource(StrEnum):
    """The simulated rig's linear model, or what was identified; auto: the latter, where given."""

    AUTO = "auto"
    RIG = "rig"
    IDENTIFIED = "identified"
