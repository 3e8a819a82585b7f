"""A folder imports only from folders below it: the list is the way up from wire to commands."""

import ast
from pathlib import Path

SOURCE = Path(__file__).parents[2]
LAYERS = (
    *("seft_msgs_py", "seft_plant_sim"),
    *("drawing", "ground_motion", "reference_force", "protection", "force_controller"),
    *("bags", "design", "test_run", "nodes"),
    *("analysis", "replay", "study", "monitor", "conformance", "paper", "cli"),
)


def imports(file):
    """Names of the modules that a file imports, with their lines."""
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.ImportFrom):
            yield from ((f"{node.module}.{each.name}", node.lineno) for each in node.names)
        elif isinstance(node, ast.Import):
            yield from ((each.name, node.lineno) for each in node.names)


def layer(parts):
    """Place in the list of a module, given by the parts of its name."""
    return LAYERS.index(parts[1] if parts[0] == "seft_ros" else parts[0])


def test_a_folder_imports_only_from_those_below_it():
    upwards = []
    for file in SOURCE.glob("*/seft_*/**/*.py"):
        own = file.relative_to(SOURCE).parts[1:]
        for name, line in imports(file):
            parts = name.split(".")
            if parts[0].startswith("seft_") and len(parts) > 1 and layer(parts) > layer(own):
                upwards.append(f"{file}, line {line}: {name}")
    assert not upwards, upwards
