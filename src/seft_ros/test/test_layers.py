"""The packages' folders, and which of them may import which."""

import ast
from pathlib import Path

SOURCE = Path(__file__).parents[2]
ROS = ("rclpy", "rcl_", "std_", "rosgraph", "ament", "trajectory_msgs", "diagnostic_msgs")
LAYERS = (  # the way up from wire to commands
    *("arrays", "printing", "errors", "files", "wire", "config", "node", "virtual"),
    "seft_plant_sim",
    *("drawing", "ground_motion", "reference_force", "protection", "force_controller"),
    *("bags", "design", "identification", "test_run", "nodes"),
    *("analysis", "replay", "study", "monitor", "check", "cli"),
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
    own = parts[0] if parts[0] in LAYERS else parts[1].removesuffix(".py")
    return LAYERS.index(own)


def test_a_folder_imports_only_from_those_below_it():
    upwards = []
    for file in SOURCE.glob("*/seft_*/**/*.py"):
        own = file.relative_to(SOURCE).parts[1:]
        for name, line in imports(file):
            parts = name.split(".")
            if parts[0].startswith("seft_") and len(parts) > 1 and layer(parts) > layer(own):
                upwards.append(f"{file}, line {line}: {name}")
    assert not upwards, upwards


def test_two_modules_of_messages_know_ros():
    """The graph as DDS, and the private part of rclpy that it needs."""
    files = (SOURCE / "seft_msgs_py" / "seft_msgs_py").rglob("*.py")
    found = {file.name for file in files if any(name.startswith(ROS) for name, _ in imports(file))}
    assert found == {"dds.py", "rclpy_interface.py"}


def defined(file):
    """Names that a module defines at its top level."""
    for node in ast.parse(file.read_text()).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.Assign | ast.AnnAssign | ast.TypeAlias):
            targets = getattr(node, "targets", None) or [getattr(node, "target", node)]
            for each in (one for target in targets for one in ast.walk(target)):
                if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store):
                    yield each.id


def test_a_public_name_means_one_thing():
    """Only the `main` of a program is in several modules."""
    places = {}
    for file in SOURCE.glob("*/seft_*/**/*.py"):
        for name in () if "templates" in file.parts else defined(file):
            if not name.startswith("_"):
                places.setdefault(name, set()).add(file.name)
    several = {name: files for name, files in places.items() if len(files) > 1}
    assert set(several) == {"main"}, several
