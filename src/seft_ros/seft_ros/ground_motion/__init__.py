"""Ground motions: read from records or made, resampled to the loop, and described."""
