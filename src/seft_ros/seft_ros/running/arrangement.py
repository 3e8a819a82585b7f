"""How the nodes of a test are put into processes, and those onto the machine."""

from dataclasses import dataclass
from typing import Any

from seft_msgs_py.node.realtime import may_keep_awake
from seft_msgs_py.wire.rigs import bare, rig_name

LOOP_NODES = ("rig", "reference_force", "force_controller")
"""Nodes that work one after the other within a step."""
GIVES_WAY = {"force_controller": 1, "reference_force": 2}
"""By how much the priority of who comes earlier in a step is lower: what is left for it to do when
its message is out must wait until the step is done."""


@dataclass(frozen=True)
class Arrangement:
    """Where the nodes of a test run.

    Attributes
    ----------
    pin : bool
        Keep the loop's nodes on one core and the others off it. They work in turn, so that a
        second core gives them nothing but wake-ups across cores. Several rigs work side by side,
        and have as many cores. All cores stay awake, where that is allowed.
    composed : bool
        Put the loop's nodes into one process; with several rigs, each rig's own.
    priority : int
        Real-time priority (of the rig; the others' are a little lower), locked memory and awake
        cores for the loop's nodes; 0: none.
    """

    pin: bool = True
    composed: bool = False
    priority: int = 0

    def wishes(self, node: str) -> dict[str, Any]:
        """Parameters by which a node of the loop asks the system for what it needs."""
        if self.priority:
            below = 0 if self.composed else GIVES_WAY.get(node, 0)
            priority = max(1, self.priority - below)
            return {"thread_priority": priority, "lock_memory": True, "keep_awake": True}
        return {"keep_awake": True} if self.pin and may_keep_awake() else {}

    def groups(self, nodes: list[str]) -> list[tuple[str, ...]]:
        """Sort nodes into processes, in order."""
        if not self.composed:
            return [(node,) for node in nodes]
        together: dict[str, list[str]] = {}  # by rig
        for node in sorted(nodes, key=lambda node: order_in_loop(bare(node))):
            if bare(node) in LOOP_NODES:
                together.setdefault(rig_name(node), []).append(node)
        alone: list[tuple[str, ...]] = [(node,) for node in nodes if bare(node) not in LOOP_NODES]
        return [*alone, *(tuple(group) for group in together.values())]


def order_in_loop(node: str) -> int:
    """Place of a node among those of the loop; behind them for another."""
    return LOOP_NODES.index(node) if node in LOOP_NODES else len(LOOP_NODES)
