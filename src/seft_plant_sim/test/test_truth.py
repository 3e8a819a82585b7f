"""What the simulated rig truly is: the facts, where nothing else is given."""

from pathlib import Path

import pytest
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import FACTS
from seft_msgs_py.errors import InputError
from seft_plant_sim.rig_parameters import RIG_TABLE, truth

JHU = Path(__file__).parents[3] / "config" / "jhu.yaml"
TRUTH = truth(RIG_TABLE.rows)


def jhu(*overrides):
    return Experiment.load([RIG_TABLE], [JHU], overrides)


@pytest.mark.parametrize(
    ("fact", "true"),
    [
        ("actuator.flow_gain", "simulated.actuator.flow_gain"),
        ("specimen.mass", "simulated.specimen.mass"),
        ("sensors.force_noise", "simulated.sensors.force_noise"),
        ("calibration.force_lag", "simulated.sensors.force_lag"),
        ("calibration.tilt", "simulated.sensors.tilt"),
    ],
)
def test_what_is_known_is_true_unless_the_truth_is_given(fact, true):
    assert jhu(("/**", fact, 0.5))["rig"][true] == 0.5
    assert jhu(("/**", fact, 0.5), ("rig", true, 0.25))["rig"][true] == 0.25
    assert jhu().changed({"/**": {fact: 0.5}})["rig"][true] == 0.5
    before = jhu()["rig"]
    pinned = jhu().changed({"rig": truth(before)}).changed({"/**": {fact: 0.5}})["rig"]
    assert truth(pinned) == truth(before)


def test_of_a_fact_that_is_not_known_the_truth_is_that_of_the_paper_s_rig():
    few = [("/**", "specimen.mass", 52.7), ("/**", "specimen.stiffness", 2.11e5)]
    valve = "actuator.valve_frequency"
    for more in ([], [("/**", valve, FACTS[valve].default)], [("/**", valve, [0.0])]):
        section = Experiment.load([RIG_TABLE], [], few + more)["rig"]
        assert section[f"simulated.{valve}"] == 70.0
    with pytest.raises(InputError, match="must be greater than zero"):
        jhu(("rig", f"simulated.{valve}", 0.0))
