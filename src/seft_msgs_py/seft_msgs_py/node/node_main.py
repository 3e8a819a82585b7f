"""The body of an executable that runs a node, or several nodes in one process."""

import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

from seft_msgs_py.config.parameter_table import Table
from seft_msgs_py.errors import SeftError
from seft_msgs_py.node.exit_watchdog import ending_within
from seft_msgs_py.node.node_process import NodeProcess
from seft_msgs_py.node.node_shell import NodeShell

CLOSE_PATIENCE = 5.0  # s


class RunningNode(Protocol):
    """What a node's executable runs."""

    def run(self) -> None:
        """Work until told to stop, spinning the shell."""

    def look(self) -> None:
        """Do what falls due by time alone, where another node of the process spins."""


@dataclass(frozen=True)
class NodeKind:
    """How a node is made.

    Attributes
    ----------
    table : Table
        Its parameters.
    tables : tuple of Table
        All tables that are known where it is, for parameters that are taken from other nodes.
    build : callable
        Makes the node in its shell, and starts the shell.
    """

    table: Table
    tables: Iterable[Table]
    build: Callable[[NodeShell], RunningNode]


def run_nodes(kinds: Sequence[NodeKind]) -> int:
    """Run nodes in this process, which share its main thread; the command line is the process's.

    Parameters
    ----------
    kinds : sequence of NodeKind
        The first one spins; the others answer the messages that come, and look at the clock
        after each turn.

    Returns
    -------
    int
        Exit status. A user's error is told in one line on stderr.
    """
    name, status = kinds[0].table.node, 1
    try:
        process = NodeProcess(sys.argv, [kind.table.node for kind in kinds])
    except SeftError as error:
        return _tell(name, error)
    try:
        shells = []
        for kind in kinds:
            name = kind.table.node
            shells.append(NodeShell(process, kind.table, kind.tables, sys.argv))
        nodes = []
        for kind, shell in zip(kinds, shells, strict=True):
            name = kind.table.node
            nodes.append(kind.build(shell))
        for node in nodes[1:]:
            process.every_turn(node.look)
        process.start()
        name = kinds[0].table.node
        nodes[0].run()
        status = 0
    except SeftError as error:
        status = _tell(name, error)
    finally:
        with ending_within(CLOSE_PATIENCE, status):
            process.close()
    return status


def run_node(kind: NodeKind) -> int:
    """Run one node in this process, see `run_nodes`."""
    return run_nodes([kind])


def _tell(node: str, error: SeftError) -> int:
    """Say a user's error in one line; return its exit status."""
    text = str(error)
    told = text if text.startswith(f"{node}: ") else f"{node}: {text}"
    print(told, file=sys.stderr, flush=True)
    return error.exit_status
