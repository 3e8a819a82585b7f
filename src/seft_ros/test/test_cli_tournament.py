import json
from pathlib import Path

import pytest
from seft_msgs_py.errors import InputError
from seft_ros.reference_force.compensation_methods import METHODS

JHU = str(Path(__file__).parents[3] / "config" / "jhu.yaml")
SHORT = ("-p", "ground_motion:synthetic.duration:=4", "-p", "ground_motion:tail:=0.5")
HERE = ("--workers", "1")


@pytest.fixture
def tournament(seft):
    """Numbers of a tournament."""

    def run(*words):
        status, out, err = seft("tournament", JHU, *SHORT, *words, "--json")
        assert status == 0
        assert "seft:" not in err
        return json.loads(out)

    return run


def places(found):
    return [(row["mass_ratio"], row["method"], row["rank"]) for row in found["standings"]]


def test_the_first_rig_has_the_numbers_of_simulate(tournament, seft):
    words = ("-p", "reference_force:mass_ratio:=0.5")
    found = tournament(*HERE, "--method", "none", "--rigs", "2", *words)
    status, out, _ = seft("simulate", JHU, *SHORT, *words, "--json")
    assert status == 0
    alone = json.loads(out)
    first, second = found["runs"]
    assert (first["rig"], first["method"], first["mass_ratio"]) == (0, "none", 0.5)
    for name in ("displacement", "acceleration", "force", "stable", "trip", "steps"):
        assert first[name] == alone[name]
    assert second["displacement"] != first["displacement"]


def test_none_is_unstable_at_mass_ratio_1_5(tournament):
    found = tournament(
        *(*HERE, "--mass-ratio", "1.5", "--rigs", "2", "--method", "none"),
        *("--method", "restoring", "-p", "ground_motion:synthetic.duration:=12"),
    )
    assert places(found) == [(1.5, "restoring", 1), (1.5, "none", 2)]
    restoring, none = found["standings"]
    assert (none["unstable_share"], none["nrmse_worst"], none["nrmse_median"]) == (1.0, None, None)
    assert restoring["unstable_share"] == 0.0
    assert restoring["nrmse_worst"] >= restoring["nrmse_median"] > 0
    assert {run["trip"] is None for run in found["runs"] if run["method"] == "none"} == {False}


def test_two_processes_find_what_one_finds(tournament, tmp_path):
    words = ("--method", "none", "--rigs", "3", "--mass-ratio", "0.5", "--mass-ratio", "0")
    one, two = (tournament(*words, "--workers", count, "--figure", "f") for count in "12")
    assert one == two
    assert [rig["rig"] for rig in one["rigs"]] == [0, 1, 2]
    assert one["rigs"][0]["specimen.stiffness"] == 2.11e5
    assert one["figure"] == "f.png"
    assert (tmp_path / "f.png").stat().st_size > 10_000


@pytest.mark.parametrize("name", ["jhu", "demo"])  # demo's controller follows a target alone
def test_every_method_there_is_takes_part_with_any_controller(seft, name):
    config = Path(JHU).with_name(f"{name}.yaml")
    status, out, _ = seft("tournament", config, *SHORT, *HERE, "--rigs", "1", "--json")
    assert status == 0
    rows = {row["method"]: row for row in json.loads(out)["standings"]}
    assert set(rows) == set(METHODS)
    for method in ("none", "restoring", "target_motion"):  # they need nothing identified
        assert rows[method]["not_possible"] is None


def test_for_people_there_is_a_table_and_why_methods_are_missing(seft, monkeypatch):
    def impossible(_):
        raise InputError("it lacks a delay")

    monkeypatch.setitem(METHODS, "impossible", impossible)
    words = (*HERE, "--rigs", "1", "--method", "none", "--method", "impossible")
    status, out, _ = seft("tournament", JHU, *SHORT, *words, "--mass-ratio", "0.5")
    assert status == 0
    for told in ("mass ratio 0.5", "none", "NRMSE", "impossible: not possible: it lacks"):
        assert told in out


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--method", "nome"], "did you mean none?"),
        (["--mass-ratio", "-1"], "mass_ratio is -1.0"),
        (["--mass-ratio", "nan"], "mass_ratio is nan"),
        (["--rigs", "0"], "--rigs"),
        (["--spread", "-0.1"], "--spread"),
        (["--workers", "0"], "--workers"),
        (["--seed", "-1"], "--seed"),
        (["--figure", "none/figure.png"], "no folder none"),
        (["--figure", "figure.docx"], "figures end in"),
        (["-p", "rig:specimen.mass:=0"], "specimen.mass is 0.0"),
        (["-p", "ground_motion:file:=none.AT2"], "none.AT2"),
        (["-p", "force_controller:denominator:=0"], "denominator is zero"),
        (["-p", "rig:actuator.oil_column_frequency:=10.08"], "perturbed rig"),
    ],
)
def test_wrong_input_is_told_in_one_line(seft, tmp_path, words, told):
    status, out, err = seft("tournament", JHU, *words)
    assert (status, out) == (2, "")
    assert err.count("\n") == 1
    assert told in err
    assert list(tmp_path.iterdir()) == []


def test_the_help_teaches_by_examples(seft):
    status, out, _ = seft("tournament", "--help")
    assert status == 0
    assert "seft tournament config/jhu.yaml --mass-ratio 0.5 --mass-ratio 1.5" in out
