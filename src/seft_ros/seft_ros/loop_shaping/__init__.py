"""Shaping of the force loop: plant, controller, margins."""

from enum import StrEnum


class Source(StrEnum):
    """The simulated rig's linear model, or what was identified; auto: the latter, where given."""

    AUTO = "auto"
    RIG = "rig"
    IDENTIFIED = "identified"
