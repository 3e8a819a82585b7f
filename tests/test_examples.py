"""The examples in config/ run, and hold what is said of them."""

import pytest
from experiments_at_hand import error_of, load, simulated
from graph_tools import ROOT

CONFIG = ROOT / "config"
EXAMPLES = (
    *("water_tower", "three_storey_frame", "six_storey_frame", "two_pier_bridge"),
    *("heavy_specimen", "position_servo"),
)


def test_each_example_beside_the_paper_s_rig_is_looked_at():
    found = {path.stem for path in CONFIG.glob("*.yaml")}
    models = {path.stem for path in CONFIG.glob("models/*.py")}  # see test_computed_models.py
    assert found == {"demo", "jhu", *EXAMPLES, *(f"computed_{name}" for name in models)}


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_is_near_the_whole_structure(name):
    recording = simulated(load(config=name))
    assert recording.trip is None
    assert error_of(recording) < 0.02
