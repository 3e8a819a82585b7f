"""Bags: the recording of a test, written, read and recovered."""
