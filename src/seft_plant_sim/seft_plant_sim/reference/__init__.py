"""The response that a perfect test would give."""
