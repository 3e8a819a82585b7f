"""Design of a test: identification of the rig, preflight."""
