"""Compensation of the actuator's delay: one file to a method, one shape for all."""
