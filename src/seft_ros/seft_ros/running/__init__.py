"""Running a test as separate node processes."""
