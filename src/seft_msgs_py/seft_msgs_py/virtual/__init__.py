"""Nodes in one process and in virtual time, for tests: `LocalGraph`."""

from seft_msgs_py.virtual.local_graph import LocalGraph

__all__ = ["LocalGraph"]
