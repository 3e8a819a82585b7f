"""The load-resisting member under test."""
