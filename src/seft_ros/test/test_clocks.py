"""A step of the system's clock moves no rig, and a node reads no clock but the one it is given."""

import ast
import subprocess
import sys
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
    "seft_msgs_py/node/transport.py": "the only one that nodes read",
    "seft_ros/bags/bag_writer.py": "the name of a bag",
    "seft_ros/test_run/stall_watch.py": "when the host stood still, for the bag",
    "seft_ros/bags/recording.py": "when the test was",
    "seft_ros/bags/recording_bag.py": "times in the bag",
    "seft_ros/cli/identify_command.py": "the folder's name",
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


NODES = """
import importlib, pkgutil, sys
import seft_msgs_py.virtual, seft_ros.nodes
for found in pkgutil.iter_modules(seft_ros.nodes.__path__, "seft_ros.nodes."):
    importlib.import_module(found.name)
assert "rclpy" not in sys.modules
for name, module in sys.modules.items():
    if name.startswith(("seft_msgs_py", "seft_plant_sim", "seft_ros")):
        print(name.split(".")[0], module.__file__)
"""
OWN_CLOCK = {
    "seft_msgs_py/node/transport.py": "the machine's clock",
    "seft_ros/bags/bag_writer.py": "when the file was flushed: time of the disk",
    "seft_plant_sim/computed/model_process.py": "its process lives by the machine's time",
    "seft_plant_sim/hardware/udp.py": "so does a laboratory's controller",
    "seft_ros/test_run/stall_watch.py": "a process of its own, which watches the machine",
}


def test_nodes_know_no_ros_and_read_no_clock_but_their_own():
    """The nodes are imported with all that they use, in an interpreter of their own."""
    printed = subprocess.run([sys.executable, "-c", NODES], capture_output=True, text=True)
    assert printed.returncode == 0, printed.stderr
    files = dict(line.split()[::-1] for line in printed.stdout.splitlines())
    assert len(files) > 50
    found = set()
    for file, package in files.items():
        for node in ast.walk(ast.parse(Path(file).read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                names = [node.module]
            if {"time", "sched"} & {*names}:
                found.add(package + file.rpartition(package)[2])
            assert not any(name.startswith(("rclpy", "std_srvs")) for name in names), file
    assert found == set(OWN_CLOCK)
