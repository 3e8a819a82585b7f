"""Bags: the record of a test, written, read and recovered."""
