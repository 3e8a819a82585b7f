"""Preflight: is a planned test stable, and how far from its limits, before anything moves."""
