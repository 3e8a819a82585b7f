"""The packages' folders, and which of them may import which."""

import ast
from pathlib import Path

import seft_msgs_py

HOME = Path(seft_msgs_py.__file__).parent


def imports(file):
    """Give the modules that a file imports anywhere in it."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module


def test_two_modules_know_ros():
    """The graph as DDS, and the private part of rclpy that it needs."""
    ros = ("rclpy", "rcl_", "std_", "rosgraph", "ament", "trajectory_msgs", "diagnostic_msgs")
    files = HOME.rglob("*.py")
    found = {file.name for file in files if any(name.startswith(ros) for name in imports(file))}
    assert found == {"dds.py", "rclpy_interface.py"}
