"""Checks that a rig's node keeps the contract that a test relies on."""
