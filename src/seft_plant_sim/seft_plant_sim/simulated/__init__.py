"""What simulates: actuator, specimen, sensors, faults."""
