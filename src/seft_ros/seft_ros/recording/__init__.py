"""Bags: written while a test runs, read back as records, recovered when cut off."""
