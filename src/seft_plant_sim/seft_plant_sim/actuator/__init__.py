"""Actuators on a specimen."""
