"""The executable of a node: its help, its process, its exit status."""

import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from textwrap import fill

from seft_msgs_py.config.parameter_table import Table
from seft_msgs_py.errors import SeftError
from seft_msgs_py.node.node_shell import NodeBody, NodeShell
from seft_msgs_py.node.transport import MakeTransport
from seft_msgs_py.node.turns import NodeProcess
from seft_msgs_py.printing import unbroken


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
        return unbroken(self.table.node, self._main)

    def _main(self) -> int:
        if {"-h", "--help"} & {*sys.argv[1:]}:
            print(self.help())
            return 0
        return run_nodes(self)

    def help(self) -> str:
        """Say what the node does, how it is started, and what parameters it has; 80 columns."""
        node, module = self.table.node, sys.modules[self.make.__module__]
        package = (module.__spec__.name if module.__spec__ else module.__name__).split(".")[0]
        text = (module.__doc__ or "").strip().replace("``", "")
        usage = "[--ros-args [--params-file FILE] [-p NAME:=VALUE] [-r __ns:=/RIG]]"
        lines = [
            "\n\n".join(fill(paragraph, 80) for paragraph in text.split("\n\n")),
            fill(f"usage: {node} {usage}", 80, subsequent_indent="    "),
            f"example:\n  ros2 run {package} {node} --ros-args --params-file config/demo.yaml",
            "parameters, with their defaults and units:",
        ]
        for row in self.table.rows.values():
            default = "required" if row.default is None else f"{row.default!r} {row.unit}".strip()
            for part, margin in ((f"{row.name}: {default}", 2 * " "), (row.description, 6 * " ")):
                lines.append(fill(part, 80, initial_indent=margin, subsequent_indent=6 * " "))
        return "\n\n".join(lines[:4]) + "\n\n" + "\n".join(lines[4:])


def run_nodes(
    *kinds: NodeKind, argv: Sequence[str] | None = None, transport: MakeTransport | None = None
) -> int:
    """Run nodes in this process, which share its main thread and its command line.

    The first one spins; the others answer their messages, and poll after each turn. A user's error
    is printed in one line on stderr.

    Parameters
    ----------
    kinds : NodeKind
        The nodes.
    argv : sequence of str, optional
        Command line; default that of this process.
    transport : callable, optional
        Makes the graph that they join; default DDS.

    Returns
    -------
    int
        Exit status.
    """
    name, status = kinds[0].table.node, 1
    argv = sys.argv if argv is None else argv
    try:
        process = NodeProcess(argv, [kind.table.node for kind in kinds], transport or _dds())
    except SeftError as error:
        return _tell(name, error)
    try:
        shells = []
        for kind in kinds:
            name = kind.table.node
            shells.append(NodeShell(process, kind.table, kind.tables, argv))
        nodes = []
        for kind, shell in zip(kinds, shells, strict=True):
            name = kind.table.node
            node = kind.make(shell)
            shell.start(node.facts)
            node.begin()
            process.fault_listeners.append(node.fault)
            nodes.append(node)
        process.polls += [node.poll for node in nodes[1:]]
        process.start()
        name = kinds[0].table.node
        nodes[0].run()
        status = 0
    except SeftError as error:
        status = _tell(name, error)
    finally:
        process.close(status)
    return status


def _dds() -> MakeTransport:
    from seft_msgs_py.node.dds import DdsTransport  # needs ROS, and a virtual graph does not

    return DdsTransport


def _tell(node: str, error: SeftError) -> int:
    """Print a user's error in one line; return its exit status."""
    text = str(error)
    print(text if text.startswith(f"{node}: ") else f"{node}: {text}", file=sys.stderr, flush=True)
    return error.exit_status
