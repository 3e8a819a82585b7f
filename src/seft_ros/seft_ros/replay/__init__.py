"""Replay of a recorded test by one node."""
