"""Ground motions: read from records or synthetic, resampled to the loop's rate, and described."""
