"""An installation by colcon: what `ros2 run PKG EXE` would find starts, and works together."""

import os
import shlex
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from graph_tools import PATIENCE, ROOT, wait_for
from seft_msgs_py.wire.topics import NODES
from seft_ros.bags.recording_bag import read_bag

pytestmark = [pytest.mark.thorough, pytest.mark.colcon]
SHORT = ("ground_motion:synthetic.duration:=3.0", "rig:pace:=lockstep", "recorder:name:=bag")
OURS = ("seft_msgs_py", "seft_plant_sim", "seft_ros")


@pytest.fixture(scope="module")
def workspace(tmp_path_factory):
    """A workspace of its own, built."""
    folder = tmp_path_factory.mktemp("workspace")
    unwanted = shutil.ignore_patterns("__pycache__", "build", "*.egg-info")
    shutil.copytree(ROOT / "src", folder / "src", ignore=unwanted)
    shutil.copytree(ROOT / "config", folder / "config")
    shutil.copy(ROOT / "colcon.meta", folder)
    colcon = Path(sys.executable).with_name("colcon")
    built = subprocess.run(
        [colcon, "build"],
        cwd=folder,
        env=os.environ | {"AMENT_PREFIX_PATH": sys.prefix},
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    assert built.returncode == 0, built.stdout + built.stderr
    assert all(f"Finished <<< {package}" in built.stdout for package in OURS)
    return folder


@pytest.fixture
def run(workspace, spawn):
    """Start an executable in the sourced workspace."""

    def launch(executable: Path, *words) -> subprocess.Popen:
        setup = workspace / "install" / "setup.sh"
        words = shlex.join(map(str, (executable, *words)))
        environment = os.environ | {"AMENT_PREFIX_PATH": sys.prefix, "PYTHONPATH": ""}
        command = f". {shlex.quote(str(setup))} && exec {words}"
        return spawn("sh", "-c", command, env=environment)

    return launch


def executables(workspace: Path) -> dict[str, Path]:
    """Find what is in lib/PKG of each package, where `ros2 run` looks for it."""
    return {
        file.name: file
        for package in OURS
        for file in (workspace / "install" / package / "lib" / package).glob("*")
    }


def problems(log: str) -> list[str]:
    """Lines of a node's log that are no mere information."""
    return [line for line in log.splitlines() if not line.startswith("[INFO]")]


def test_installed_nodes_run_a_test(workspace, run, observer, tmp_path):
    found = executables(workspace)
    assert sorted(found) == sorted([*NODES, "loop", "seft"])
    share = workspace / "install" / "seft_ros" / "share" / "seft_ros"
    assert (share / "launch" / "experiment.launch.py").is_file()
    ros = ["--ros-args", "--params-file", share / "config" / "jhu.yaml"]
    ros += [word for override in SHORT for word in ("-p", override)]
    nodes = [run(found[node], *ros) for node in NODES]
    wait_for(lambda: (observer.spin(0.05), observer.state == "ready")[1], "ready")
    assert observer.call("start")[0]
    wait_for(lambda: (observer.spin(0.05), observer.recorder_phase == "saved")[1], "saved")
    for node in nodes:
        node.send_signal(signal.SIGINT)
    for node in nodes:
        out, errors = node.communicate(timeout=PATIENCE)
        assert (node.returncode, out, problems(errors)) == (0, "", [])
    assert read_bag(tmp_path / "bags" / "bag").complete


@pytest.mark.parametrize("words", [("loop", "--help"), ("seft", "simulate", "--help")])
def test_installed_executables_beside_the_nodes_explain_themselves(workspace, run, words):
    name, *options = words
    process = run(executables(workspace)[name], *options)
    out, errors = process.communicate(timeout=PATIENCE)
    assert (process.returncode, errors) == (0, "")
    assert "--" in out
