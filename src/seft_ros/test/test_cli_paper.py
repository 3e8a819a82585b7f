"""``seft paper`` from end to end, and what it refuses before it works."""

import json
import re
from pathlib import Path

import pytest
from seft_ros.paper import findings, paper_tests
from seft_ros.paper.paper_tests import default_config

ROOT = Path(__file__).parents[3]
RECORDS = ROOT.parent / "shared" / "data"
SHORT = (
    *("-p", "ground_motion:synthetic.duration:=10", "-p", "ground_motion:tail:=0.5"),
    *("-p", "ground_motion:synthetic.seed:=1"),
)


def test_a_short_synthetic_motion_makes_a_page_and_claims(seft, monkeypatch, tmp_path):
    monkeypatch.setattr(findings, "DURATION", 40.0)
    status, out, err = seft("paper", *SHORT, "--workers", "1", "--json", "--out", "found")
    assert status == 0
    assert "seft:" not in err
    found = json.loads(out)
    for claim in found["claims"]:
        assert {"claim", "paper", "ours", "agrees", "criterion"} <= set(claim)
        assert isinstance(claim["agrees"], bool)
    told = {claim["claim"]: claim["agrees"] for claim in found["claims"]}
    assert len(told) == len(found["claims"])  # each is said once
    for claim in (
        "natural frequency, identified",
        "valve-to-force response has a zero at 10 Hz",
        "and a pole around 90 Hz",
        "crossover frequency",
        "force is controlled up to 25 Hz",
        "displacement agrees with the reference at alpha = 0",
        "discrepancy of the displacement grows: alpha = 0, 0.5, 1.0",
        "high-frequency acceleration appears at alpha = 1.0",
        "test at alpha = 1.5",
        "displacement with delay compensation agrees with the reference at alpha = 0.5",
        "displacement with delay compensation agrees with the reference at alpha = 1",
    ):
        assert told[claim] is True
    assert told["delay of the actuator, identified"] is False
    assert found["agree"] + found["disagree"] == len(told)
    assert (found["synthetic"], found["page"]) == (True, "found.html")
    assert "synthetic" in found["record"]
    page = (tmp_path / "found.html").read_text()
    for heading in ("Figure 3", "Figure 4", "Figure 6", "Figure 7", "Figure 8", "Beyond the paper"):
        assert re.search(rf"<h2>{heading}", page)
    assert [path.name for path in tmp_path.iterdir()] == ["found.html"]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--file", "none.AT2"], "none.AT2"),
        (["--unit", "cm/s2"], "--unit: needs a record"),
        (["--file", "none.AT2", "--unit", "feet"], "unit is"),
        (["--out", "none/paper.html"], "no folder none"),
        (["--out", "paper.pdf"], "pages end in .html"),
        (["none.yaml"], "none.yaml"),
        (["-p", "rig:actuator.kind:=delay"], "needs servo_hydraulic"),
        (["-p", "reference_force:method:=eft"], "needs seft"),
        (["-p", "rate:=100.0"], "rate is 100 Hz"),
        (["-p", "rig:specimen.mass:=0"], "specimen.mass is 0.0"),
        (["--workers", "0"], "--workers"),
    ],
)
def test_wrong_input_is_told_in_one_line_before_the_work(seft, tmp_path, words, told):
    words = ["-p", f"/**:{words[1]}"] if words[1:] == ["rate:=100.0"] else words
    status, out, err = seft("paper", *words)
    assert (status, out) == (2, "")
    assert told in err.splitlines()[-1]
    assert list(tmp_path.iterdir()) == []


def test_the_help_says_that_a_claim_may_fail(seft):
    status, out, _ = seft("paper", "--help")
    assert status == 0
    assert "a finding, not a failure" in " ".join(out.split())
    assert "seft paper --file kobe.txt" in out


def test_the_papers_rig_is_found_in_the_source_tree():
    assert default_config().resolve() == ROOT / "config" / "jhu.yaml"


@pytest.mark.parametrize("packages", ["lib/python3.12/site-packages", "lib/python3/dist-packages"])
def test_the_papers_rig_is_found_where_it_was_installed(tmp_path, monkeypatch, packages):
    package = tmp_path / packages / "seft_ros"
    installed = tmp_path / "share" / "seft_ros" / "config" / "jhu.yaml"
    for path in (package / "__init__.py", installed):
        path.parent.mkdir(parents=True)
        path.touch()
    monkeypatch.setattr(paper_tests.seft_ros, "__file__", str(package / "__init__.py"))
    assert default_config() == installed


@pytest.mark.skipif(not RECORDS.is_dir(), reason="no real records beside the project")
def test_a_record_takes_the_place_of_the_synthetic_motion():
    from seft_ros.cli.shared import given_motion, load_experiment

    words = {"unit": "cm/s2", "dt": 0.005, "column": None}
    file = RECORDS / "kobe_jma_1995.txt"
    section = load_experiment(default_config(), None)["ground_motion"]
    section |= given_motion(section, file, "paper", **words)
    assert (section["file"], section["unit"], section["dt"]) == (str(file), "cm/s2", 0.005)
    assert section["peak_force"] == 1000.0
