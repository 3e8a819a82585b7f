"""Protection of the reference force: ramp-down, plausibility, instability watch, detectors."""
