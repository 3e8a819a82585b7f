"""The body of an executable that runs a node, or several nodes in one process."""

import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from textwrap import fill, indent
from typing import Any

from seft_msgs_py.config.parameter_table import Table
from seft_msgs_py.errors import SeftError
from seft_msgs_py.node.node_process import NodeProcess
from seft_msgs_py.node.node_shell import IDLE_WAIT, NodeShell
from seft_msgs_py.node.process import exit_watchdog
from seft_msgs_py.wire.messages import OK, Status
from seft_msgs_py.wire.outcome import tripped_status

CLOSE_PATIENCE = 5.0  # s


class NodeBody:
    """What a node does in its shell; subclasses override what they need.

    Attributes
    ----------
    facts : dict
        What others must know of this node besides its parameters; JSON values.
    """

    def __init__(self, shell: NodeShell) -> None:
        self._shell = shell
        self.facts: dict[str, Any] = {}

    def report(
        self, phase: str, values: Mapping[str, str] | None = None, level: int = OK, text: str = ""
    ) -> None:
        """Publish the node's phase as its status."""
        values = {"phase": phase, **(values or {})}
        self._shell.report(Status(self._shell.name, level, text or phase, values=values))

    def begin(self) -> None:
        """Report the first status, after the node's description."""

    def run(self) -> None:
        """Work until the process ends, spinning the shell."""
        while not self._shell.stopping:
            self._shell.spin_once(self.period())
            self._shell.attempt("a poll", self.poll)

    def fault(self, reason: str) -> None:
        """End the test because of a fault of the program, in any node of this process."""
        self._shell.report(tripped_status(self._shell.name, reason, 0))

    def poll(self) -> None:
        """Do what is due by time; called after each turn, whichever node spins."""

    def period(self) -> float:
        """Longest time between two polls, s."""
        return IDLE_WAIT


@dataclass(frozen=True)
class NodeKind:
    """How a node is made.

    Attributes
    ----------
    table : Table
        Its parameters.
    tables : tuple of Table
        All known tables, because parameters may take their values from other nodes.
    make : callable
        Makes the node in its shell.
    """

    table: Table
    tables: Iterable[Table]
    make: Callable[[NodeShell], NodeBody]

    def main(self) -> int:
        """Run this node in this process, or print its help; return the exit status."""
        if {"-h", "--help"} & {*sys.argv[1:]}:
            print(self.help())
            return 0
        return run_nodes(self)

    def help(self) -> str:
        """Say what the node does, how it is started, and what parameters it has; 80 columns."""
        node, module = self.table.node, sys.modules[self.make.__module__]
        package = (module.__spec__.name if module.__spec__ else module.__name__).split(".")[0]
        usage = "[--ros-args [--params-file FILE] [-p NAME:=VALUE] [-r __ns:=/RIG]]"
        lines = [
            (module.__doc__ or "").strip().replace("``", ""),
            f"usage: {node} {usage}",
            f"example: ros2 run {package} {node} --ros-args --params-file config/demo.yaml",
            "parameters, with their defaults and units:",
        ]
        for row in self.table.rows.values():
            default = "required" if row.default is None else f"{row.default!r} {row.unit}".strip()
            lines.append(f"  {row.name}: {default}\n{indent(fill(row.description, 74), 6 * ' ')}")
        return "\n\n".join(lines[:4]) + "\n\n" + "\n".join(lines[4:])


def run_nodes(*kinds: NodeKind) -> int:
    """Run nodes in this process, which share its main thread and its command line.

    The first one spins; the others answer their messages, and poll after each turn. A user's error
    is printed in one line on stderr. Returns the exit status.
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
            node = kind.make(shell)
            shell.start(node.facts)
            node.begin()
            shell.on_fault(node.fault)
            nodes.append(node)
        for node in nodes[1:]:
            process.every_turn(node.poll)
        process.start()
        name = kinds[0].table.node
        nodes[0].run()
        status = 0
    except SeftError as error:
        status = _tell(name, error)
    finally:
        with exit_watchdog(CLOSE_PATIENCE, status):
            process.close()
    return status


def _tell(node: str, error: SeftError) -> int:
    """Print a user's error in one line; return its exit status."""
    text = str(error)
    print(text if text.startswith(f"{node}: ") else f"{node}: {text}", file=sys.stderr, flush=True)
    return error.exit_status
