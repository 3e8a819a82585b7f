"""Identification of a rig: its actuators, channels and specimen, from tests of their own."""
