import getpass
import json
import shutil
import socket
import subprocess
from datetime import datetime
from pathlib import Path

import pytest
from seft_msgs_py.errors import InputError
from seft_ros.bags import recording

NODE = {"rate": 500.0, "axes": ["x"], "seed": 7}
needs_git = pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")


@pytest.fixture
def checkout(tmp_path):
    def git(*arguments):
        who = ("-c", "user.name=n", "-c", "user.email=e")
        words = ["git", "-C", tmp_path, *who, *arguments]
        subprocess.run(words, check=True, capture_output=True)

    git("init")
    (tmp_path / "code.py").write_text("a = 1\n")
    git("add", "code.py")
    git("commit", "-m", "first")
    recording.git_state.cache_clear()
    yield tmp_path
    recording.git_state.cache_clear()


def test_environment_is_json_and_tells_mode_start_and_versions():
    described = recording.describe_environment("lockstep")
    environment = json.loads(json.dumps(described, allow_nan=False))
    assert environment["mode"] == "lockstep"
    start = datetime.fromisoformat(environment["start"])
    assert start.tzinfo is not None
    assert abs((datetime.now(start.tzinfo) - start).total_seconds()) < 60
    assert environment["versions"]["numpy"].count(".") == 2
    assert environment["cpus"] >= 1


def test_environment_names_no_person_host_or_folder():
    text = json.dumps(recording.describe_environment("simulate"))
    assert str(Path.home()) not in text
    assert str(Path.cwd()) not in text
    for name in (socket.gethostname(), getpass.getuser()):
        assert f'"{name}"' not in text


@needs_git
def test_git_revision_is_reported_and_whether_python_files_differ(checkout):
    head = subprocess.check_output(["git", "-C", checkout, "rev-parse", "HEAD"], text=True).strip()
    assert recording.git_state(checkout / "code.py") == {"revision": head, "dirty": False}
    recording.git_state.cache_clear()
    (checkout / "notes.txt").write_text("no code")
    assert recording.git_state(checkout / "code.py")["dirty"] is False
    recording.git_state.cache_clear()
    (checkout / "code.py").write_text("a = 2\n")
    assert recording.git_state(checkout / "code.py") == {"revision": head, "dirty": True}


@needs_git
def test_a_file_that_git_does_not_track_has_no_revision(checkout):
    (checkout / "site-packages").mkdir()
    installed = checkout / "site-packages" / "code.py"
    installed.write_text("a = 1\n")
    assert recording.git_state(installed) is None


def test_without_git_there_is_no_revision(tmp_path, monkeypatch):
    recording.git_state.cache_clear()
    monkeypatch.setenv("PATH", str(tmp_path))
    assert recording.git_state(Path(__file__)) is None
    recording.git_state.cache_clear()


def test_description_is_read_back_with_what_a_node_says_beside_its_parameters():
    sections = {"rig": NODE, "recorder": {"rate": 500.0, "axes": ["x"], "directory": "bags"}}
    facts = {"rig": {"motion": {"unit": "g"}, "steps": 3}}
    texts = recording.write_description(sections, {"mode": "simulate"}, facts)
    assert len(texts) == 3
    description, refused = recording.read_description(texts)
    assert description == recording.Description(sections, {"mode": "simulate"}, facts)
    assert refused == 0
    assert description.experiment().axes == ("x",)


def test_of_a_node_that_describes_itself_twice_the_last_counts():
    texts = [
        *recording.write_description({"rig": NODE}, {}),
        json.dumps({"node": "rig", "parameters": {**NODE, "seed": 8}, "fact": 1}),
    ]
    assert recording.read_description(texts)[0].sections["rig"]["seed"] == 8


@pytest.mark.parametrize(
    "text",
    ["", "no json", "[]", "3", '{"node": "rig"}', '{"node": 3, "parameters": {}}', "[" * 9999],
)
def test_text_that_describes_nothing_is_counted(text):
    description, refused = recording.read_description([text])
    assert refused == 1
    with pytest.raises(InputError, match="no node"):
        description.experiment()


@pytest.mark.parametrize(
    "parameters", [{}, {"rate": "fast", "axes": ["x"]}, {"rate": 500.0}, {"rate": 500.0, "axes": 3}]
)
def test_parameters_that_make_no_experiment_are_one_line_to_the_user(parameters):
    with pytest.raises(InputError):
        recording.Description({"rig": parameters}).experiment()
