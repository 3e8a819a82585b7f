"""Reference force, with compensation of the actuator."""
