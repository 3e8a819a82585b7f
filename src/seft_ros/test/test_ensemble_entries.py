from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from seft_msgs_py.config.experiment import Experiment, parse_override
from seft_msgs_py.errors import InputError
from seft_plant_sim.rig_parameters import TABLE
from seft_ros.ensemble.entries import UNCERTAINTY, check_rig, perturbed_rig
from seft_ros.test_run.parameter_tables import TABLES

JHU = Path(__file__).parents[3] / "config" / "jhu.yaml"
TWO_AXES = ("axes:=[x, y]", "rig:specimen.stiffness:=[2.11e5, -3e4, -3e4, 2.2e5]")


def load(*words):
    return Experiment.load(TABLES, [JHU], [parse_override(word) for word in words])


EXPERIMENT = load()


def perturbed(number, seed=1, spread=0.2, experiment=EXPERIMENT):
    return perturbed_rig(experiment["rig"], experiment.axes, seed, number, spread)


def test_every_uncertain_parameter_is_one_of_the_rig():
    assert set(UNCERTAINTY) <= set(TABLE.rows)


def test_the_first_rig_is_the_configured_one():
    assert perturbed(0) == EXPERIMENT["rig"]


@given(st.integers(1, 10_000), st.integers(0, 2**32), st.floats(0.0, 1.0))
def test_parameters_stay_within_their_spread_and_the_others_as_they_are(number, seed, spread):
    own, nominal = perturbed(number, seed, spread), EXPERIMENT["rig"]
    assert own.keys() == nominal.keys()
    for name, value in nominal.items():
        if name == "seed":
            continue
        if name not in UNCERTAINTY or value == 0:
            assert own[name] == value
            continue
        most = 1.0 + UNCERTAINTY[name] * spread
        assert 1 / most - 1e-12 <= own[name] / value <= most + 1e-12
    assert TABLE.check(own) == own


def test_a_spread_of_a_fifth_is_20_percent_stiffness_and_twice_or_half_the_damping():
    rigs = [perturbed(number) for number in range(1, 2001)]
    for name, most in (("specimen.stiffness", 1.2), ("specimen.damping", 2.0)):
        factors = np.array([rig[name] for rig in rigs]) / EXPERIMENT["rig"][name]
        assert factors.max() == pytest.approx(most, rel=0.01)
        assert factors.min() == pytest.approx(1 / most, rel=0.01)
        assert np.median(factors) == pytest.approx(1.0, abs=0.03)


def test_a_rig_is_a_matter_of_seed_and_number_alone():
    assert perturbed(3) == perturbed(3)
    assert perturbed(3) != perturbed(4)
    assert perturbed(3) != perturbed(3, seed=2)
    assert len({perturbed(number)["seed"] for number in range(50)}) == 50


def test_without_spread_only_the_noise_differs():
    assert perturbed(3, spread=0.0) | {"seed": 1} == EXPERIMENT["rig"]


def test_actuators_differ_from_axis_to_axis_and_the_specimen_stays_symmetric():
    experiment = load(*TWO_AXES)
    section = perturbed(1, experiment=experiment)
    first, second = section["actuator.flow_gain"]
    assert first != second
    stiffness = np.array(section["specimen.stiffness"]) / experiment["rig"]["specimen.stiffness"]
    assert stiffness == pytest.approx(np.full(4, stiffness[0]))
    check_rig(section, experiment.axes, experiment.timebase, 1)


def test_a_rig_that_can_not_be_is_refused_by_its_number():
    experiment = load("rig:actuator.oil_column_frequency:=10.1")
    section = experiment["rig"] | {"specimen.stiffness": 4e5}
    with pytest.raises(InputError, match=r"^perturbed rig 5: .*oil_column.*smaller spread"):
        check_rig(section, experiment.axes, experiment.timebase, 5)
    with pytest.raises(InputError, match=r"^rig: actuator"):
        check_rig(section, experiment.axes, experiment.timebase, 0)
