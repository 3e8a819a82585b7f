"""How the nodes of a test are put into processes, and those onto the machine."""

from dataclasses import dataclass

LOOP_NODES = ("rig", "reference_force", "force_controller")
"""Nodes that work one after the other within a step."""


@dataclass(frozen=True)
class Arrangement:
    """Where the nodes of a test run.

    Attributes
    ----------
    pin : bool
        Keep the loop's nodes on one core and the others off it. They work in turn, so that a
        second core gives them nothing but wake-ups across cores.
    composed : bool
        Put the loop's nodes into one process.
    priority : int
        Real-time priority and locked memory for the loop's nodes; 0: none.
    """

    pin: bool = True
    composed: bool = False
    priority: int = 0

    def groups(self, nodes: list[str]) -> list[tuple[str, ...]]:
        """Sort nodes into processes, in order."""
        together = tuple(node for node in LOOP_NODES if node in nodes) if self.composed else ()
        alone: list[tuple[str, ...]] = [(node,) for node in nodes if node not in together]
        return [*alone, together] if together else alone
