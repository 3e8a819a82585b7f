"""A test as a whole: parameter tables, blocks, offline loop, states."""
