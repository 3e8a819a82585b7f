"""Feeding a recorded test to one node, and holding its answers against the recorded ones."""
