"""A step of the system's clock moves no rig: nothing that waits or watches reads that clock."""

import ast
from pathlib import Path

import seft_msgs_py
import seft_plant_sim
import seft_ros

WALL = {
    ("time", "time"),
    ("time", "time_ns"),
    ("time", "localtime"),
    ("datetime", "now"),
    ("datetime", "today"),
    ("time", "CLOCK_REALTIME"),
}
ALLOWED = {
    "seft_msgs_py/node/clock.py": "the only one that nodes read",
    "seft_msgs_py/node/node_shell.py": "stamps of diagnostics",
    "seft_msgs_py/node/node_process.py": "when a message came, for the bag",
    "seft_msgs_py/wire/topics.py": "common start of several hosts, refused where clocks differ",
    "seft_ros/nodes/supervisor_node.py": "the same",
    "seft_ros/nodes/recorder_node.py": "times in the bag, and its name",
    "seft_ros/test_run/run.py": "the bag's name",
    "seft_ros/test_run/observer.py": "when a message was sent, for conform and replay",
    "seft_ros/conformance/suite.py": "the same",
    "seft_ros/bags/stall_watch.py": "when the host stood still, for the bag",
    "seft_ros/bags/record.py": "when the test was",
    "seft_ros/bags/record_bag.py": "times in the bag",
    "seft_ros/cli/design_commands.py": "the folder's name",
}


def test_the_system_s_clock_is_read_for_labels_alone():
    found = set()
    for package in (seft_msgs_py, seft_plant_sim, seft_ros):
        home = Path(package.__file__).parent
        for file in home.rglob("*.py"):
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                    if (node.value.id, node.attr) in WALL:
                        found.add(str(file.relative_to(home.parent)))
                elif isinstance(node, ast.ImportFrom) and node.module == "time":
                    assert not {alias.name for alias in node.names} & {"time", "time_ns"}, file
    page = {file for file in found if "/monitor/" in file}  # shows it
    assert found - page <= set(ALLOWED)
