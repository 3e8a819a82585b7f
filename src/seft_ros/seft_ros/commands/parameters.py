"""``seft parameters``: the parameter tables, as text for people and for docs."""

from typing import Annotated, Optional

import typer
from seft_msgs_py.config.parameter_table import COMMON, Parameter, nearest
from seft_msgs_py.errors import InputError

from seft_ros.test_run.parameter_tables import TABLES


def parameters(
    node: Annotated[
        Optional[str], typer.Argument(metavar="NODE", help="One node; default all.")
    ] = None,
) -> int:
    """Print every parameter with type, default, unit, bounds and meaning, as Markdown.

    Examples:

        seft parameters rig

        seft parameters > docs/parameters.md
    """
    names = [table.node for table in TABLES]
    if node is not None and node not in names:
        raise InputError(f"there is no node {node}{nearest(node, names)}")
    print(parameters_text([node] if node else names))
    return 0


def parameters_text(nodes: list[str]) -> str:
    """Markdown tables of some nodes' parameters."""
    common = [row.name for row in COMMON]
    parts = [
        "# Parameters\n\nMade by `seft parameters`. A value in *italics* is taken from another "
        "parameter of the same experiment where it is not given; **required** ones have none. "
        "All are read when a node starts and then fixed, but for those marked *live*: "
        "`ros2 param set` changes them for their next use.",
        "## every node, under `/**`\n\n" + _table(COMMON),
    ]
    for table in TABLES:
        if table.node in nodes:
            own = tuple(row for name, row in table.rows.items() if name not in common)
            parts.append(f"## {table.node}\n\n{_table(own)}")
    return "\n\n".join(parts)


def _table(rows: tuple[Parameter, ...]) -> str:
    lines = ["| parameter | type | default | unit | meaning |", "|---|---|---|---|---|"]
    for row in rows:
        meaning = row.description.replace("|", "\\|") + (" (*live*)" if row.live else "")
        lines.append(f"| `{row.name}` | {_type(row)} | {_default(row)} | {row.unit} | {meaning} |")
    return "\n".join(lines)


def _type(row: Parameter) -> str:
    if row.choices:
        return " \\| ".join(f"`{choice}`" for choice in row.choices)
    if row.file_name:
        return "name of a file"
    limits = ((">", 0 if row.positive else None), (">=", row.minimum), ("<=", row.maximum))
    bounds = [f"{sign} {value:g}" for sign, value in limits if value is not None]
    return f"{row.kind} {', '.join(bounds)}".strip()


def _default(row: Parameter) -> str:
    own = "**required**" if row.default is None else f"`{row.default!r}`".replace("'", '"')
    return f"*{row.default_from}*, else {own}" if row.default_from else own
