"""The simulated rig: actuator, specimen, sensors and limits."""
