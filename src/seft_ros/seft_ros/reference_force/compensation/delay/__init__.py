"""What methods share that compensate a delay, given or followed."""
