"""What brings a test down softly: ramp, plausibility, guards."""
