"""Bags: the record of a test, written, read, recovered and replayed."""
