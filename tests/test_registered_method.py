"""A compensation method of somebody else's package takes part like ours."""

import os

import pytest
from graph_tools import JHU, STALLS_ALLOWED

METHOD = '''"""Half of the measured acceleration is fed back."""

import numpy as np
from seft_ros.reference_force.compensation.linear_filter import LinearCompensator, LinearFilter


def half(knowledge):
    n = knowledge.axes
    measured = np.zeros((n, 4 * n))
    measured[:, 2 * n : 3 * n] = -0.5 * knowledge.computed_mass
    return LinearCompensator(LinearFilter.of_gains(measured, -knowledge.total_mass))
'''
SHORT = ("-p", "ground_motion:synthetic.duration:=3.0", "-p", "reference_force:mass_ratio:=0.4")
CHOSEN = ("-p", "reference_force:compensation.method:=half")


@pytest.fixture
def package(tmp_path, monkeypatch):
    """An installed package that registers a method, and one that is not there."""
    folder = tmp_path / "installed"
    described = folder / "their_lab-1.0.dist-info"
    described.mkdir(parents=True)
    (folder / "their_methods.py").write_text(METHOD)
    (described / "METADATA").write_text("Metadata-Version: 2.1\nName: their-lab\nVersion: 1.0\n")
    (described / "entry_points.txt").write_text(
        "[seft.compensation]\nhalf = their_methods:half\nlost = their_methods:nothing\n"
    )
    paths = [str(folder), *filter(None, [os.environ.get("PYTHONPATH")])]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(paths))


@pytest.mark.usefixtures("package")
def test_a_registered_method_gives_the_same_bits_over_dds_and_is_known_to_preflight(
    seft, seft_json
):
    words = (JHU, *SHORT, *CHOSEN)
    found = seft_json("preflight", *words)
    assert found["critical_mass_ratio"] > 1.5 * seft_json("preflight", JHU)["critical_mass_ratio"]
    seft_json("simulate", *words, "--out", "simulated")
    seft_json("run", *words, "-p", "rig:pace:=lockstep", *STALLS_ALLOWED, "--out", "lockstep")
    assert seft_json("compare", "simulated", "lockstep")["identical"] is True
    lost = ("-p", "reference_force:compensation.method:=lost")
    (line,) = seft("simulate", JHU, *lost, status=2).stderr.strip().splitlines()
    assert "package their-lab has no their_methods:nothing that can be loaded" in line


def test_a_method_that_nobody_registered_is_refused(seft):
    (line,) = seft("simulate", JHU, *CHOSEN, status=2).stderr.strip().splitlines()
    assert 'compensation.method is "half", but must be one of none, ' in line
