"""The report of a test: one page that says whether it can be trusted, and where not."""
