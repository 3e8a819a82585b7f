"""A whole test: its blocks, the offline loop, the node processes, and its states."""
