"""Experiments as ROS 2 parameter files: read, check, override, write.

ROS ignores parameters it does not know, and files for nodes it does not know. Here both are
errors that name the nearest known one.
"""

from collections.abc import Iterable, Mapping, Sequence
from io import StringIO
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.scalarstring import DoubleQuotedScalarString

from seft_msgs_py.config.parameter_file import (
    EVERY_NODE,
    PARAMETERS_KEY,
    Override,
    read_parameter_file,
)
from seft_msgs_py.config.parameter_table import COMMON, Section, Table, Value, nearest, resolve
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.rigs import rigs_of
from seft_msgs_py.wire.timebase import Timebase

_COMMON_TABLE = Table(EVERY_NODE, ())


class Experiment:
    """All parameters of a test, checked and complete.

    Parameters
    ----------
    sections : mapping
        Node name -> parameter name -> value. Of nodes that each of several rigs has there is
        one section, of which every rig takes what is of its axes.

    Attributes
    ----------
    timebase : Timebase
        Sampling clock.
    axes : tuple of str
        Names of the axes, of all rigs.
    rigs : tuple of RigAxes
        Whose they are.
    """

    def __init__(self, sections: Mapping[str, Section]) -> None:
        self.sections = {node: dict(section) for node, section in sections.items()}
        for name in (row.name for row in COMMON):
            values = {node: section[name] for node, section in self.sections.items()}
            (first, value), *others = values.items()
            for node, other in others:
                if other != value:
                    raise InputError(
                        f"{node}: {name} is {other}, but {first} has {value}; "
                        f"set it once, under {EVERY_NODE}"
                    )
        self.timebase = Timebase.from_rate(value_of(self.sections, "rate"))
        self.axes = tuple(value_of(self.sections, "axes"))
        if len(set(self.axes)) != len(self.axes) or not all(self.axes):
            raise InputError(f"{EVERY_NODE}: axes are {list(self.axes)}, but names must differ")
        if not "".join(self.axes).isprintable():
            raise InputError(f"{EVERY_NODE}: axes are {list(self.axes)}, but must be printable")
        try:
            self.rigs = rigs_of(self.axes)
        except InputError as error:
            raise InputError(f"{EVERY_NODE}: {error}") from None

    @classmethod
    def load(
        cls,
        tables: Iterable[Table],
        files: Sequence[str | Path] = (),
        overrides: Sequence[Override] = (),
        nodes: Iterable[str] | None = None,
    ) -> "Experiment":
        """Read parameter files, apply overrides, check, and fill in defaults.

        Parameters
        ----------
        tables : iterable of Table
            Tables of the nodes the experiment is to hold. Sections of other known nodes are
            read only for the values that tables take from them.
        files : sequence of path
            Later files win.
        overrides : sequence of (node, parameter, value)
            Win over files; node ``/**`` means every node.
        nodes : iterable of str, optional
            Nodes whose sections are wanted, complete; default all that have a table.

        Raises
        ------
        InputError
            In one line: what, where, and what is allowed.
        """
        by_node = {table.node: table for table in tables}
        given: dict[str, Section] = {}
        for file in files:
            sections = read_parameter_file(file)
            for node in sorted(sections, key=lambda node: node != EVERY_NODE):  # as rclpy does
                _merge(given, node, sections[node], by_node, str(file))
        for node, name, value in overrides:
            _merge(given, node, {name: value}, by_node, "-p")
        everywhere = given.pop(EVERY_NODE, {})
        for node in (*by_node, *given):
            given[node] = {**everywhere, **given.get(node, {})}
        return cls(resolve(by_node, given, nodes))

    def __getitem__(self, node: str) -> Section:
        return self.sections[node]

    def to_yaml(self) -> str:
        """Text of a ROS 2 parameter file that holds every parameter."""
        tree: dict[str, Any] = {}
        common = [row.name for row in COMMON]
        first = next(iter(self.sections.values()))
        tree[EVERY_NODE] = {PARAMETERS_KEY: {name: _quoted(first[name]) for name in common}}
        for node, section in self.sections.items():
            own = {name: _quoted(v) for name, v in section.items() if name not in common}
            tree[node] = {PARAMETERS_KEY: own}
        stream = StringIO()
        yaml = YAML()
        yaml.dump(tree, stream)
        return stream.getvalue()


def value_of(sections: Mapping[str, Section], name: str) -> Value:
    """Value of a parameter that all sections share."""
    return next(iter(sections.values()))[name]


def _merge(
    given: dict[str, Section], node: str, section: Section, tables: dict[str, Table], where: str
) -> None:
    table = _COMMON_TABLE if node == EVERY_NODE else tables.get(node)
    at = f"{where}: {node}"
    if node == EVERY_NODE:
        # a wildcard parameter of one node only is legal ROS; it goes to the nodes that know it
        for name in [name for name in section if name not in _COMMON_TABLE.rows]:
            owners = [other for other, rows in tables.items() if name in rows.rows]
            if not owners:
                known = {row for rows in tables.values() for row in rows.rows}
                raise InputError(f"{at}: there is no parameter {name}{nearest(name, known)}")
            for owner in owners:
                _merge(given, owner, {name: section[name]}, tables, where)
        section = {name: v for name, v in section.items() if name in _COMMON_TABLE.rows}
    checked = table.check(section, at) if table else section
    given.setdefault(node, {}).update(checked)


def _quoted(value: Value) -> Value:
    """Texts in quotes, wherever they stand: to rcl, whose YAML is 1.1, a plain y is true."""
    if isinstance(value, list):
        return [_quoted(item) for item in value]
    return DoubleQuotedScalarString(value) if isinstance(value, str) else value
