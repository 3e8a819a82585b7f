"""Experiments as ROS 2 parameter files: read, check, override, write.

ROS ignores parameters it does not know, and files for nodes it does not know. Here both are
errors that name the nearest known one.
"""

import functools
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from io import StringIO
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError
from ruamel.yaml.scalarstring import DoubleQuotedScalarString

from seft_msgs_py.config.facts import BY_AXIS, EVERY_NODE, FACTS, MATRICES, agree, fact_of, place_of
from seft_msgs_py.config.parameter_table import (
    Parameter,
    Section,
    Table,
    Value,
    as_matrix,
    nearest,
    per_axis,
)
from seft_msgs_py.errors import InputError
from seft_msgs_py.files import check_regular, open_regular
from seft_msgs_py.wire.topics import NODES, Timebase, rigs_of

PARAMETERS_KEY = "ros__parameters"
PARAMETER_OPTIONS = ("--params-file", "-p", "--param")
"""Options of a node's command line for parameters."""

LARGEST_FILE = 1_000_000
"""Bytes; a test of many axes has some thousand, and a million take a minute to parse."""

MAX_AXES = 100
"""The rig's model has some ten states for each, and takes minutes to prepare beyond that."""

Override = tuple[str, str, Value]  # node, parameter, value


class Experiment:
    """All parameters of a test, checked and complete: node name -> parameter name -> value.

    With several rigs, the nodes of the same name share one section; each rig takes the values of
    its own axes from it.

    Parameters
    ----------
    sections : mapping
        The values by node.
    source : Source, optional
        What they were made of; default the values themselves.

    Attributes
    ----------
    timebase : Timebase
        Sampling clock.
    axes : tuple of str
        Names of the axes, of all rigs.
    rigs : tuple of RigAxes
        The rigs, with their axes.
    """

    def __init__(self, sections: Mapping[str, Section], source: "Source | None" = None) -> None:
        self.sections = {node: dict(section) for node, section in sections.items()}
        self._source = source
        known: dict[str, tuple[str, Value]] = {}
        for node, own in self.sections.items():
            for name in filter(FACTS.__contains__, own):
                first, value = known.setdefault(name, (node, own[name]))
                if not agree(name, own[name], value):
                    other = f"{first} has {value}; set it once, under {EVERY_NODE}"
                    raise InputError(f"{node}: {name} is {own[name]}, but {other}")
        common = next(iter(self.sections.values()))
        self.timebase = Timebase.from_rate(common["rate"])
        self.axes = tuple(common["axes"])
        if len(self.axes) > MAX_AXES:
            most = f"a test has at most {MAX_AXES}"
            raise InputError(f"{EVERY_NODE}: there are {len(self.axes)} axes, but {most}")
        if len(set(self.axes)) != len(self.axes) or not all(self.axes):
            raise InputError(f"{EVERY_NODE}: axes are {list(self.axes)}, but names must differ")
        if not "".join(self.axes).isprintable():
            raise InputError(f"{EVERY_NODE}: axes are {list(self.axes)}, but must be printable")
        self.rigs = rigs_of(self.axes)
        for name in (one for one in (*BY_AXIS, *MATRICES) if one in known):
            fit = as_matrix if name in MATRICES else per_axis
            fit(known[name][1], self.axes, f"{EVERY_NODE}: {name}")

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
            Tables of the experiment's nodes.
        files : sequence of path
            Later files win.
        overrides : sequence of (node, parameter, value)
            Win over files; node ``/**`` means every node.
        nodes : iterable of str, optional
            Nodes whose sections are checked and complete; default all that have a table. Of the
            others only the `SETTINGS` are read.

        Raises
        ------
        InputError
            In one line: what, where, and what is allowed.
        """
        by_node = {table.node: table for table in tables}
        wanted = tuple(by_node if nodes is None else nodes)
        source = Source(by_node, wanted, tuple(files), tuple(overrides))
        for file in source.files:
            sections = read_parameter_file(file)
            for node in sorted(sections, key=lambda node: node != EVERY_NODE):  # as rclpy does
                source.add(node, sections[node], f"{file}: {node}")
        for place, name, value in source.overrides:
            source.add(place, {name: value}, f"-p: {place}")
        return cls(source.resolve(), source)

    def __getitem__(self, node: str) -> Section:
        return self.sections[node]

    def changed(self, changes: Mapping[str, Section]) -> "Experiment":
        """Copy it with other values: place in a file -> parameter name -> value."""
        if self._source is not None:
            source = self._source.changed(changes)
            return Experiment(source.resolve(), source)
        sections = {node: dict(section) for node, section in self.sections.items()}
        for place, own in changes.items():
            for node, name in ((node, name) for node in sections for name in own):
                if node == place or (name in sections[node] and place_of(name, node) == place):
                    sections[node][name] = own[name]
        return Experiment(sections)

    def by_place(self) -> dict[str, Section]:
        """Give all values by their places in a file."""
        whole = dict[str, Section]()
        for node, own in self.sections.items():
            for name, value in own.items():
                whole.setdefault(place_of(name, node), {})[name] = value
        return whole

    def arguments(self) -> list[str]:
        """Words of a node's command line that give it these parameters; see `split_ros_arguments`.

        They name the files as they were given, so that the node reads what the user wrote.
        """
        source = self._source
        if source is not None:
            files, overrides = source.files, source.overrides
        else:
            files, whole = (), self.by_place()
            overrides = [(place, *item) for place, own in whole.items() for item in own.items()]
        words = [word for file in files for word in ("--params-file", str(file))]
        for place, name, value in overrides:
            words += ["-p", f"{place}:{name}:={value_text(value)}"]
        return words


_OF_ROS = ("use_sim_time", "qos_overrides", "start_type_description_service")
"""Parameters, or groups of them, that rclpy gives each node."""


@dataclass(frozen=True)
class Source:
    """What an experiment is made of.

    Attributes
    ----------
    tables : dict of str to Table
        By node.
    nodes : tuple of str
        Nodes whose sections are checked and complete.
    files : sequence of path
        Parameter files.
    overrides : sequence of (place, parameter, value)
        What replaces values of the files.
    given : dict of str to dict
        The values of both, by their place in a file.
    """

    tables: dict[str, Table]
    nodes: tuple[str, ...]
    files: Sequence[str | Path] = ()
    overrides: Sequence[Override] = ()
    given: dict[str, Section] = field(default_factory=dict)

    def changed(self, changes: Mapping[str, Section]) -> "Source":
        """Copy it with other values: place in a file -> parameter name -> value."""
        new = [
            (place, name, value) for place, own in changes.items() for name, value in own.items()
        ]
        given = {place: dict(own) for place, own in self.given.items()}
        source = replace(self, overrides=[*self.overrides, *new], given=given)
        for place, own in changes.items():
            source.add(place, own, place)
        return source

    def add(self, place: str, section: Section, where: str) -> None:
        """Take the values of a section, which stand at ``where``; those of wanted nodes checked."""
        for name, value in section.items():
            if name.split(".")[0] in _OF_ROS:
                if name == "use_sim_time" and value is True:
                    other = "nodes of seft follow the samples of the rig, not /clock; leave it out"
                    raise InputError(f"{where}: use_sim_time is true, but {other}")
            elif place == EVERY_NODE:
                self._add_everywhere(name, value, where)
            elif place not in self.nodes:
                self.given.setdefault(place, {})[name] = value
            elif (right := place_of(name, place)) != place:
                truth = f"simulated.{name}"
                known = truth in self.tables[place].rows
                more = f"; what the simulated rig truly has is rig: {truth}" if known else ""
                raise InputError(f"{where}: {name} is set once, under {right}{more}")
            else:
                checked = self.tables[place].check({name: value}, where)
                self.given.setdefault(place, {}).update(checked)

    def _add_everywhere(self, name: str, value: Value, where: str) -> None:
        """Take a fact, or what ROS permits: a parameter for all nodes that know it."""
        if name in FACTS:
            self.given.setdefault(EVERY_NODE, {})[name] = FACTS[name].check(value, where)
            return
        tables = self.tables.values()
        owners = [t for t in tables if name in t.rows and place_of(name, t.node) == t.node]
        if not owners:
            hint = nearest(name, {row for table in tables for row in table.rows})
            raise InputError(f"{where}: there is no parameter {name}{hint}")
        for owner in owners:
            self.given.setdefault(owner.node, {})[name] = owner.rows[name].check(value, where)

    def resolve(self) -> dict[str, Section]:
        """Complete the sections of the wanted nodes; InputError if a required value is missing."""
        return {
            node: {name: self._value(node, row) for name, row in self.tables[node].rows.items()}
            for node in self.nodes
        }

    def _value(self, node: str, row: Parameter) -> Value:
        place, name = place_of(row.name, node), row.name
        value = self.given.get(place, {}).get(name)
        if value is None and (fact := fact_of(name)):
            value = self.given.get(EVERY_NODE, {}).get(fact)
            if row.positive and not any(value if isinstance(value, list) else [value]):
                value = None  # not known
            if value is None and row.default is None:
                place, name = EVERY_NODE, fact
        value = row.default if value is None else value
        if value is None:
            meaning = f"{row.description}, {row.unit}" if row.unit else row.description
            raise InputError(f"{place}: {name} must be given ({meaning})")
        return row.check(value, place)


def read_parameter_file(path: str | Path) -> dict[str, Section]:
    """Read a file: node name (or ``/**``) -> parameter name with dots -> value, unchecked.

    Raises
    ------
    InputError
        If the file can't be read, is larger than `LARGEST_FILE`, is no YAML, or does not have the
        form of a parameter file.
    """
    path = Path(path)
    try:
        with open_regular(path) as file:
            content = file.read(LARGEST_FILE + 1)
        if len(content) > LARGEST_FILE:
            raise InputError(
                f"{path}: is larger than {LARGEST_FILE / 1e6:g} MB, the limit of parameter files; "
                "name another file"
            )
        text = content.decode()
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file; expected a ROS 2 parameter file") from None
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from None
    tree = _parse_yaml(text, str(path))
    if not isinstance(tree, dict) or not tree:
        raise InputError(f"{path}: holds no node names; expected a ROS 2 parameter file")
    sections: dict[str, Section] = {}
    for key, content in tree.items():
        node = str(key)
        node = node if node == EVERY_NODE else node.lstrip("/")
        if node not in (*NODES, EVERY_NODE):
            raise InputError(f"{path}: there is no node {key}{nearest(node, NODES)}")
        if not isinstance(content, dict) or set(content) != {PARAMETERS_KEY}:
            raise InputError(f"{path}: under {key} there must be {PARAMETERS_KEY}, and only that")
        parameters = {} if content[PARAMETERS_KEY] is None else content[PARAMETERS_KEY]
        if not isinstance(parameters, dict):
            raise InputError(f"{path}: {key} {PARAMETERS_KEY} must hold names and values")
        for name, value in _flatten(parameters, str(path), node).items():
            if name in sections.setdefault(node, {}):
                raise InputError(f"{path}: {node} {name} is given twice")
            sections[node][name] = value
    return sections


def value_text(value: Value) -> str:
    """Text of a value in an override ``node:parameter:=value``, in one line."""
    yaml, stream = YAML(), StringIO()
    yaml.default_flow_style = True
    yaml.width = sys.maxsize
    yaml.dump([_quoted(value)], stream)
    return stream.getvalue().strip()[1:-1]


def parameter_text(sections: Mapping[str, Section], comments: Sequence[str] = ()) -> str:
    """Text of a ROS 2 parameter file: node name -> parameter name -> value, comments above."""
    yaml = YAML()
    yaml.default_flow_style = None  # lists in one line
    yaml.width = 4096
    tree = {
        node: {PARAMETERS_KEY: {name: _quoted(value) for name, value in section.items()}}
        for node, section in sections.items()
    }
    stream = StringIO()
    stream.writelines(f"# {line}\n" for line in comments)
    yaml.dump(tree, stream)
    return stream.getvalue()


def write_parameter_file(
    path: Path, sections: Mapping[str, Section], comments: Sequence[str] = (), replace: bool = False
) -> None:
    """Write a file, to be read after an experiment's own; see `parameter_text`.

    With ``replace`` it may exist already.

    Raises
    ------
    InputError
        If the file exists already or can't be written.
    """
    check_regular(path)
    try:
        with path.open("w" if replace else "x", encoding="utf-8") as file:
            file.write(parameter_text(sections, comments))
    except FileExistsError:
        raise InputError(f"{path}: exists already; name another file") from None
    except OSError as error:
        raise InputError(f"{path}: can't be written: {error.strerror or error}") from None


def parse_override(text: str) -> Override:
    """Read ``node:parameter:=value``; without a node it applies to every node."""
    target, separator, value = text.partition(":=")
    node, colon, name = target.rpartition(":")
    if not separator or not name or (colon and not node):
        raise InputError(f"-p {text}: expected node:parameter:=value")
    node = node.lstrip("/") if node and node != EVERY_NODE else EVERY_NODE
    if node not in (*NODES, EVERY_NODE):
        raise InputError(f"-p {text}: there is no node {node}{nearest(node, NODES)}")
    return node, name, _parse_yaml(value, f"-p {text}")


def split_ros_arguments(argv: Sequence[str]) -> tuple[list[str], list[Override], list[str]]:
    """Parameter files, overrides, and all other words of a node's command line.

    Only words between ``--ros-args`` and ``--`` are parameters.

    Raises
    ------
    InputError
        If an option has no value, or an override does not have the form ``name:=value``.
    """
    files: list[str] = []
    overrides: list[Override] = []
    others: list[str] = []
    words = iter(argv)
    inside = False
    for word in words:
        if not inside or word not in PARAMETER_OPTIONS:
            inside = word == "--ros-args" or (inside and word != "--")
            others.append(word)
            continue
        value = next(words, None)
        if value is None:
            raise InputError(f"{word} needs a value")
        if word == "--params-file":
            files.append(value)
        else:
            overrides.append(parse_override(value))
    return files, overrides, others


def _flatten(tree: Mapping[Any, Any], path: str, node: str, prefix: str = "") -> Section:
    flat: Section = {}
    if prefix.count(".") > 50:  # an alias inside itself
        raise InputError(f"{path}: {node} {prefix[:50]}... is nested too deep")
    for key, value in tree.items():
        name = f"{prefix}{key}"
        if value is None:
            raise InputError(f"{path}: {node} {name} has no value")
        inside = isinstance(value, Mapping)
        own = _flatten(value, path, node, name + ".") if inside else {name: value}
        if twice := [one for one in own if one in flat]:
            raise InputError(f"{path}: {node} {twice[0]} is given twice")
        flat |= own
    return flat


@functools.lru_cache(256)  # nodes of one process read the same files
def _parse_yaml(text: str, where: str) -> Any:
    try:
        return YAML(typ="safe", pure=True).load(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark
        line = f" line {mark.line + 1}" if mark is not None else ""
        raise InputError(f"{where}:{line} {error.problem or error.context}") from None
    except RecursionError:
        raise InputError(f"{where}: is nested too deep") from None
    except Exception as error:  # ruamel raises many kinds at invalid input
        raise InputError(f"{where}: {(str(error).splitlines() or ['no YAML'])[0]}") from None


def _quoted(value: Value) -> Value:
    """Put all texts in quotes: rcl reads YAML 1.1, in which a plain y is true."""
    if isinstance(value, list):
        return [_quoted(item) for item in value]
    return DoubleQuotedScalarString(value) if isinstance(value, str) else value
