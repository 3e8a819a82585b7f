"""ROS 2 parameter files, and parameters on command lines, read (not yet checked) and written."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError

from seft_msgs_py.config.parameter_table import Section, Value, nearest
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import NODES

EVERY_NODE = "/**"
PARAMETERS_KEY = "ros__parameters"

LARGEST_FILE = 1_000_000
"""Bytes; a test of many axes has some thousand, and to parse a million takes a minute."""

Override = tuple[str, str, Value]  # node, parameter, value


def read_parameter_file(path: str | Path) -> dict[str, Section]:
    """Read a file: node name (or ``/**``) -> parameter name with dots -> value, unchecked.

    Raises
    ------
    InputError
        If the file can't be read, is larger than `LARGEST_FILE`, is no YAML, or has not the form
        of a parameter file.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            content = file.read(LARGEST_FILE + 1)
        if len(content) > LARGEST_FILE:
            raise InputError(
                f"{path}: is larger than {LARGEST_FILE / 1e6:g} MB, which no parameter file is; "
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
        sections[node] = {**sections.get(node, {}), **_flatten(parameters, str(path), node)}
    return sections


def write_parameter_file(
    path: Path, sections: Mapping[str, Section], comments: Sequence[str] = ()
) -> None:
    """Write a new file, with comments above, to be read after an experiment's own.

    Raises
    ------
    InputError
        If the file exists already or can't be written.
    """
    yaml = YAML()
    yaml.default_flow_style = None  # lists in one line
    yaml.width = 4096
    tree = {node: {PARAMETERS_KEY: dict(section)} for node, section in sections.items()}
    try:
        with path.open("x", encoding="utf-8") as file:
            file.writelines(f"# {line}\n" for line in comments)
            yaml.dump(tree, file)
    except FileExistsError:
        raise InputError(f"{path}: exists already; name another file") from None
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from None


def parse_override(text: str) -> Override:
    """Read ``node:parameter:=value``; without a node it is meant for every node."""
    target, separator, value = text.partition(":=")
    node, colon, name = target.rpartition(":")
    if not separator or not name or (colon and not node):
        raise InputError(f"-p {text}: expected node:parameter:=value")
    node = node.lstrip("/") if node and node != EVERY_NODE else EVERY_NODE
    if node not in (*NODES, EVERY_NODE):
        raise InputError(f"-p {text}: there is no node {node}{nearest(node, NODES)}")
    return node, name, _parse_yaml(value, f"-p {text}")


def split_ros_arguments(argv: Sequence[str]) -> tuple[list[str], list[Override]]:
    """Parameter files and overrides in a node's command line (``--ros-args ... --``).

    Raises
    ------
    InputError
        If an option has no value, or an override has not the form ``name:=value``.
    """
    files: list[str] = []
    overrides: list[Override] = []
    words = iter(argv)
    inside = False
    for word in words:
        if word == "--ros-args":
            inside = True
        elif word == "--":
            inside = False
        elif inside and word in ("--params-file", "-p", "--param"):
            value = next(words, None)
            if value is None:
                raise InputError(f"{word} needs a value")
            if word == "--params-file":
                files.append(value)
            else:
                overrides.append(parse_override(value))
    return files, overrides


def _flatten(tree: Mapping[Any, Any], path: str, node: str, prefix: str = "") -> Section:
    flat: Section = {}
    if prefix.count(".") > 50:  # an alias inside itself
        raise InputError(f"{path}: {node} {prefix[:50]}... is nested too deep")
    for key, value in tree.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            flat.update(_flatten(value, path, node, name + "."))
        elif value is None:
            raise InputError(f"{path}: {node} {name} has no value")
        else:
            flat[name] = value
    return flat


def _parse_yaml(text: str, where: str) -> Any:
    try:
        return YAML(typ="safe", pure=True).load(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark
        line = f" line {mark.line + 1}" if mark is not None else ""
        raise InputError(f"{where}:{line} {error.problem or error.context}") from None
    except Exception as error:  # at odd input ruamel lets all kinds of them through
        raise InputError(f"{where}: {(str(error).splitlines() or ['no YAML'])[0]}") from None
