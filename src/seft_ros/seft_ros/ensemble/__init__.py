"""Many tests on all cores or machines: methods against one another, and uncertain rigs."""
