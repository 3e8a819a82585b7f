"""Checks of a rig's hardware that only its motion can make."""
