"""A new package is whole, has its own name everywhere, and its test passes."""

import os
import subprocess
import sys


def test_a_new_driver_is_short_has_its_own_name_and_its_test_passes(seft, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, out, err = seft("new", "driver", "my_rig")
    assert (status, err) == (0, "")
    assert "seft check laboratory.yaml" in out
    files = [file for file in (tmp_path / "my_rig").rglob("*") if file.is_file()]
    names = {"README.md", "my_rig.py", "laboratory.yaml", "test_my_rig.py"}
    assert {file.name for file in files} == names
    assert not [file for file in files if "rig_driver" in f"{file} {file.read_text()}"]
    assert sum(len(file.read_text().splitlines()) for file in files) <= 120
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "my_rig"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert (done.returncode, "1 passed" in done.stdout) == (0, True), done.stdout
    assert "my_rig: exists already" in seft("new", "driver", "my_rig")[2]
    file = str(tmp_path / "my_rig" / "laboratory.yaml")
    status, _, err = seft("simulate", file, "--json", "--out", str(tmp_path / "bag"))
    assert status == 0, err
