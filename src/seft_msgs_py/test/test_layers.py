"""The packages' folders, and which of them may import which."""

import ast
from pathlib import Path

import pytest
import seft_msgs_py

HOME = Path(seft_msgs_py.__file__).parent
BELOW = {
    "wire": {"arrays", "errors"},
    "config": {"arrays", "errors", "files", "printing", "wire"},
    "node": {"arrays", "errors", "printing", "wire", "config"},
    "virtual": {"arrays", "errors", "wire", "config", "node"},
}


def imports(file):
    """Give the modules that a file imports anywhere in it."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module


@pytest.mark.parametrize("folder", BELOW)
def test_no_folder_imports_one_above_it(folder):
    for file in (HOME / folder).rglob("*.py"):
        for name in imports(file):
            package, _, rest = name.partition(".")
            if package == "seft_msgs_py":
                assert rest.split(".")[0] in BELOW[folder] | {folder}, f"{file} imports {name}"


def test_two_modules_know_ros():
    """The graph as DDS, and the private part of rclpy that it needs."""
    ros = ("rclpy", "rcl_", "std_", "rosgraph", "ament", "trajectory_msgs", "diagnostic_msgs")
    files = HOME.rglob("*.py")
    found = {file.name for file in files if any(name.startswith(ros) for name in imports(file))}
    assert found == {"dds.py", "rclpy_interface.py"}


def test_one_module_reads_the_machine_s_clock():
    files = HOME.rglob("*.py")
    found = {file.name for file in files if {"time", "datetime"} & {*imports(file)}}
    assert found == {"clock.py"}
