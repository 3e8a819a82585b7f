"""The judge of the samples, and the detectors of faults."""
