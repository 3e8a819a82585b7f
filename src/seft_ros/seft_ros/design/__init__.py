"""Design of a test: its plant, stability and margins, and whether its numbers are plausible."""
