"""What the simulated rig truly is: the facts, where nothing else is given.

Of every fact, see seft_ros's test_parameter_tables.py.
"""

from pathlib import Path

import pytest
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_plant_sim.rig_parameters import RIG_TABLE, truth

JHU = Path(__file__).parents[3] / "config" / "jhu.yaml"


def test_a_truth_that_is_pinned_stays_whatever_is_known():
    test = Experiment.load([RIG_TABLE], [JHU])
    true = truth(test["rig"])
    known = dict.fromkeys(("actuator.flow_gain", "calibration.force_lag", "specimen.mass"), 0.5)
    assert truth(test.changed({"/**": known})["rig"]) != true
    assert truth(test.changed({"rig": true}).changed({"/**": known})["rig"]) == true


def test_a_truth_may_not_be_what_no_rig_is():
    with pytest.raises(InputError, match="must be greater than zero"):
        Experiment.load([RIG_TABLE], [JHU], [("rig", "simulated.actuator.valve_frequency", 0.0)])
