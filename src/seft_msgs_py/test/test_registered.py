"""What other packages register: found by name, made with settings, one clear error else."""

import sys
import types

import pytest
from seft_msgs_py.config.registered import Registered
from seft_msgs_py.errors import InputError


def own_factory(knowledge, gain=1.0):
    return knowledge, gain


@pytest.fixture
def group(tmp_path, monkeypatch):
    described = tmp_path / "their_lab-1.0.dist-info"
    described.mkdir()
    (described / "METADATA").write_text("Metadata-Version: 2.1\nName: their-lab\nVersion: 1.0\n")
    (described / "entry_points.txt").write_text(
        "[seft.test]\ngood = their_module:factory\nlost = their_module:nothing\nours = x:y\n"
    )
    module = types.ModuleType("their_module")
    module.factory = own_factory
    monkeypatch.setitem(sys.modules, "their_module", module)
    monkeypatch.syspath_prepend(str(tmp_path))
    return Registered("seft.test", ("ours",))


def test_a_parameter_takes_names_of_others_and_tells_them_apart_from_ours(group):
    row = group.row("method", "ours", "")
    assert row.check("good", "node") == "good"
    assert (row.choices, row.registered) == (("ours",), ("good", "lost"))
    with pytest.raises(InputError, match="must be one of ours, good, lost; did you mean good"):
        row.check("goood", "node")


@pytest.mark.parametrize(
    ("settings", "gain"),
    [
        ("", 1.0),
        ("gain=2.5", 2.5),
        ("gain=[1,2.5]", [1, 2.5]),
        ("gain=a", "a"),
        ("'gain=a b'", "a b"),
    ],
)
def test_one_is_made_of_what_is_known_and_its_settings(group, settings, gain):
    assert group.make("good", settings, "node: method", "known") == ("known", gain)


@pytest.mark.parametrize(
    ("name", "settings", "words"),
    [
        ("lost", "", "node: method is lost, but package their-lab has no their_module:nothing"),
        ("good", "gain='2", "node: method: settings.*No closing quotation"),
        ("good", "gain 2.0", "'gain' is not of the form name=value"),
        ("good", "gian=2.0", "its settings do not fit their_module:factory.*'gian'"),
    ],
)
def test_what_can_not_be_made_gets_one_clear_error(group, name, settings, words):
    with pytest.raises(InputError, match=words):
        group.make(name, settings, "node: method", "known")


def test_a_file_may_import_its_neighbours(group, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", sys.path.copy())
    folder = tmp_path / "driver"
    folder.mkdir()
    (folder / "its_board.py").write_text("VOLTS = 10.0\n")
    (folder / "driver.py").write_text("import its_board\ndef make(): return its_board.VOLTS\n")
    assert group.make(f"{folder / 'driver.py'}:make", "", "rig: hardware") == 10.0
