"""A new package is whole, has its own name everywhere, and its tests pass."""

import os
import subprocess
import sys


def test_a_new_driver_has_its_own_name_everywhere_and_its_tests_pass(seft, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, out, err = seft("new", "driver", "my_rig")
    assert (status, err) == (0, "")
    assert "seft conform" in out
    files = [file for file in (tmp_path / "my_rig").rglob("*") if file.is_file()]
    assert {"package.xml", "rig.yaml", "driver_node.py", "my_rig"} <= {file.name for file in files}
    assert not [file for file in files if "rig_driver" in f"{file} {file.read_text()}"]
    assert "my_rig.driver_node:main" in (tmp_path / "my_rig" / "setup.py").read_text()
    path = os.pathsep.join([str(tmp_path / "my_rig"), *sys.path])
    environment = {**os.environ, "PYTHONPATH": path}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "my_rig/test"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert (done.returncode, "2 passed" in done.stdout) == (0, True), done.stdout
    assert "my_rig: exists already" in seft("new", "driver", "my_rig")[2]
