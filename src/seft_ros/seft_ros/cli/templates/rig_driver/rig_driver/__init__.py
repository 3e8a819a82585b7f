"""Driver of a laboratory's rig: the node ``rig`` of a substructure effective force test."""
