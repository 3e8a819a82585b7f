"""Readers of recorded motions: one module for a family of files, one for what headers state."""
