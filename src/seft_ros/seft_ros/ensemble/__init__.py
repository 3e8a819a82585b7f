"""Many tests at once: the loop of the plain blocks, compiled, with the plain blocks' matrices."""
