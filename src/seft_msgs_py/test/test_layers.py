"""The packages' folders, and which of them may import which."""

import ast
from pathlib import Path

import pytest
import seft_msgs_py

HOME = Path(seft_msgs_py.__file__).parent
BELOW = {
    "wire": {"arrays", "errors"},
    "config": {"arrays", "errors", "wire"},
    "node": {"arrays", "errors", "wire", "config"},
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


@pytest.mark.parametrize("folder", ["wire", "config"])
def test_the_wire_and_the_parameters_need_no_ros(folder):
    for file in (HOME / folder).rglob("*.py"):
        assert not any(name.startswith(("rclpy", "rcl_")) for name in imports(file)), file
