"""A page that shows a running test, and its server."""
