"""The examples in config/ run, and hold what is said of them."""

import pytest
from graph_tools import ROOT, STALLS_ALLOWED

CONFIG = ROOT / "config"
LARGEST_ERROR = {
    "water_tower": 0.02,
    "three_storey_frame": 0.02,
    "six_storey_frame": 0.02,
    "two_pier_bridge": 0.02,
}
SHORT = ("-p", "ground_motion:synthetic.duration:=6.0", "-p", "ground_motion:tail:=0.5")


def test_each_example_beside_the_paper_s_rig_is_looked_at():
    found = {path.stem for path in CONFIG.glob("*.yaml")}
    models = {path.stem for path in CONFIG.glob("models/*.py")}  # see test_computed_models.py
    assert found == {"demo", "jhu", *LARGEST_ERROR, *(f"computed_{name}" for name in models)}


@pytest.mark.parametrize("name", LARGEST_ERROR)
def test_an_example_is_near_the_whole_structure(seft_json, name):
    summary = seft_json("simulate", CONFIG / f"{name}.yaml", "--out", "bag")
    assert summary["displacement"]["nrmse"] < LARGEST_ERROR[name]


@pytest.mark.parametrize("yield_displacement", [0.008, 0.004])
def test_a_frame_whose_storeys_yield_is_near_the_whole_structure(seft_json, yield_displacement):
    words = (
        "rig:specimen.kind:=bouc_wen",
        "rig:specimen.springs:=[1.0, 0.0, 0.0, -1.0, 1.0, 0.0, 0.0, -1.0, 1.0]",  # storeys
        f"rig:specimen.yield_displacement:={yield_displacement}",
    )
    overrides = [part for word in words for part in ("-p", word)]
    frame = CONFIG / "three_storey_frame.yaml"
    summary = seft_json("simulate", frame, *overrides, "--out", "bag")
    assert summary["stable"] is True
    assert summary["displacement"]["nrmse"] < 0.05


@pytest.mark.parametrize("name", LARGEST_ERROR)
def test_an_example_gives_the_same_bits_over_dds(seft_json, name):
    config = CONFIG / f"{name}.yaml"
    seft_json("simulate", config, *SHORT, "--out", "simulated")
    words = (*SHORT, "-p", "rig:pace:=lockstep", *STALLS_ALLOWED)
    arrangement = () if name == "six_storey_frame" else ("--composed",)
    seft_json("run", config, *words, *arrangement, "--out", "lockstep")
    assert seft_json("compare", "simulated", "lockstep")["identical"] is True
