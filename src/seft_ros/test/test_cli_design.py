import json
from pathlib import Path

import pytest
from seft_msgs_py.config.experiment import Experiment
from seft_ros.test_run.parameter_tables import TABLES

JHU = str(Path(__file__).parents[3] / "config" / "jhu.yaml")
PAPER = ("--numerator", "37", "--denominator", "1 17.14 4002")
TWO_AXES = (
    *("-p", "axes:=[x, y]"),
    *("-p", "rig:specimen.stiffness:=[2.11e5, -3e4, -3e4, 2.2e5]"),
)
KEYS = {
    *("plant_source", "plant_zero_hz", "plant_zero_damping", "plant_pole_hz"),
    *("plant_pole_damping", "crossover_hz", "crossovers_hz", "phase_margin_deg"),
    *("gain_margin_db", "phase_crossover_hz", "sensitivity_peak", "sensitivity_peak_hz"),
    *("closed_loop_flat_to_hz", "bandwidth_hz", "delay_s", "dip_db", "stable", "controller"),
    *("discretisation", "proposed", "figure", "axes"),
}


@pytest.fixture
def design(seft):
    """Numbers of a design that must come out stable."""

    def run(*words):
        status, out, err = seft("design", *words, "--json")
        assert (status, err) == (0, "")
        return json.loads(out)

    return run


def test_the_papers_rig_does_what_the_paper_says(design, tmp_path):
    found = design(JHU, "--figure", "design.png")
    assert set(found) >= KEYS
    assert (found["plant_source"], found["proposed"], found["stable"]) == ("rig", False, True)
    assert found["plant_zero_hz"] == pytest.approx(10.07, abs=0.05)
    assert found["plant_pole_hz"] == pytest.approx(90.0, abs=2.0)
    assert found["crossover_hz"] == pytest.approx(12.0, abs=0.5)
    assert found["crossovers_hz"] == [found["crossover_hz"]]
    assert found["phase_margin_deg"] > 45
    assert found["gain_margin_db"] > 6
    assert found["closed_loop_flat_to_hz"] >= 25
    assert 0.013 < found["delay_at_zero_s"] < 0.0155
    assert 0.010 < found["delay_s"] < 0.017
    assert found["controller"]["numerator"] == [37.0]
    assert (tmp_path / found["figure"]).stat().st_size > 10_000


def test_continuous_time_hides_what_the_loop_loses(design):
    parts = design(JHU)["discretisation"]
    crossover = parts["sampled"]["crossover_hz"]
    lost = parts["continuous"]["phase_margin_deg"] - parts["sampled"]["phase_margin_deg"]
    # the step of latency, half a step of hold, and the dead time; the crossovers differ a little
    assert lost == pytest.approx(360 * crossover * (0.002 + 0.001 + 0.001), abs=1.5)


def test_a_proposal_is_written_for_seft_to_read_back(design, seft, tmp_path):
    found = design(JHU, "--crossover", "12", "--out", "controller.yaml")
    assert (found["proposed"], found["out"]) == (True, "controller.yaml")
    assert found["controller"]["numerator"] == pytest.approx([37.0], rel=0.06)
    assert found["controller"]["denominator"] == pytest.approx([1.0, 17.14, 4002.0], rel=0.15)
    merged = Experiment.load(TABLES, [JHU, tmp_path / "controller.yaml"])
    for name in ("numerator", "denominator"):
        assert merged["force_controller"][name] == found["controller"][name]
    again = design(JHU, "--params-file", "controller.yaml")
    assert again["controller"] == found["controller"]
    assert again["crossover_hz"] == pytest.approx(12.0)
    status, out, err = seft("design", JHU, "--out", "controller.yaml")
    assert (status, out) == (2, "")
    assert "controller.yaml: exists already" in err


def test_a_controller_may_be_given_by_its_coefficients(design):
    found = design(JHU, "-p", "force_controller:numerator:=1.0", *PAPER)
    assert found["controller"] == design(JHU)["controller"]


def test_the_identified_plant_counts_where_it_is_given(design):
    given = ("plant.numerator:=7000", "plant.denominator:=[1, 0.5]", "plant.dead_time:=0.002")
    words = [word for text in given for word in ("-p", f"force_controller:{text}")]
    identified = design(JHU, *words, "--numerator", "0.01", "--denominator", "1")
    assert identified["plant_source"] == "identified"
    assert identified["crossover_hz"] == pytest.approx(70 / 6.2832, rel=0.01)
    assert (identified["plant_zero_hz"], identified["plant_pole_hz"]) == (None, None)
    assert design(JHU, *words, "--plant", "rig")["plant_source"] == "rig"


def test_every_axis_is_told_and_one_is_shown(design):
    words = (*TWO_AXES, "--numerator", "18", "--denominator", "1 16.45 4003")
    first, second = design(JHU, *words), design(JHU, *words, "--axis", "y")
    assert [axis["axis"] for axis in first["axes"]] == ["x", "y"]
    assert first["axes"] == second["axes"]
    x, y = first["axes"]
    assert x["stable"] and y["stable"]
    assert x["crossover_hz"] == pytest.approx(6.0, rel=0.05)
    assert y["crossover_hz"] != pytest.approx(x["crossover_hz"], rel=1e-3)
    for shown, axis in ((first, x), (second, y)):
        assert (shown["crossover_hz"], shown["gain_margin_db"]) == (
            axis["crossover_hz"],
            axis["gain_margin_db"],
        )


def test_an_unstable_loop_is_status_1_and_is_not_written(seft, tmp_path):
    words = ("--numerator", "150", "--denominator", "1 16.3 3948", "--out", "c.yaml")
    status, out, err = seft("design", JHU, *words)
    assert status == 1
    assert "crossover" in out
    assert err.startswith("seft: unstable: with this controller")
    assert err.count("\n") == 1
    assert not (tmp_path / "c.yaml").exists()


def test_for_people_there_is_a_table(seft):
    status, out, err = seft("design", JHU, *TWO_AXES, "--crossover", "6")
    assert (status, err) == (0, "")
    for words in ("oil column", "phase margin", "as it runs", "axis"):
        assert words in out


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["none.yaml"], "none.yaml"),
        ([JHU, "--plant", "rigg"], "rigg"),
        ([JHU, "--plant", "identified"], "seft identify"),
        ([JHU, "--axis", "z"], "no such axis"),
        ([JHU, "--crossover", "60"], "the highest that can is"),
        ([JHU, "--crossover", "12", *PAPER], "leave out"),
        ([JHU, "--numerator", "1"], "go together"),
        ([JHU, "--numerator", "1 0 0", "--denominator", "1"], "improper"),
        ([JHU, "--numerator", "1", "--denominator", "1 -1000"], "1000 rad/s"),
        ([JHU, "-p", "rig:actuator.kind:=ideal"], "no valve"),
        ([JHU, "--out", "none/controller.yaml"], "no folder"),
        ([JHU, "--figure", "none/design.png"], "none/design.png"),
    ],
)
def test_wrong_input_is_told_in_one_line(seft, tmp_path, words, told):
    status, out, err = seft("design", *words)
    assert (status, out) == (2, "")
    assert err.count("\n") == 1
    assert told in err
    assert list(tmp_path.iterdir()) == []


def test_the_help_teaches_by_examples(seft):
    status, out, _ = seft("design", "--help")
    assert status == 0
    assert "--crossover 12 --out" in out
