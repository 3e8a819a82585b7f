"""Tests on other masses, oil columns and rates, and what preflight says of them."""

import math

import numpy as np
import pytest
from experiments_at_hand import load
from scaled_rigs import scaled_rig
from seft_ros.analysis.summary import summarise_briefly
from seft_ros.design.planned_tests import PlannedTest
from seft_ros.design.plausibility import expected_response
from seft_ros.design.preflight_tables import planned_motion
from seft_ros.design.stability_verdict import check_stability, folded
from seft_ros.study.unforeseen import LARGEST_ERROR, YieldingError, yielding_error
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.offline import BlockCache, simulate_test

CACHE = BlockCache()
RIGS = ((20.0, 120.0, 1000.0), (52.7, 89.0, 250.0), (800.0, 23.0, 2000.0), (20000.0, 6.0, 500.0))


def scaled_test(*args, **options):
    return load(*scaled_rig(*args, **options), config="demo")


def error(experiment):
    found = summarise_briefly(CACHE.run(experiment), CACHE.reference(experiment))
    assert found["trip"] is None
    return found["displacement"]["nrmse"]


@pytest.mark.parametrize(("mass", "oil_hz", "rate"), RIGS)
def test_a_linear_specimen_of_any_mass_moves_as_it_should(mass, oil_hz, rate):
    for hz, leakage in ((1.5, 50.0), (6.0, 20.0)):
        assert error(scaled_test(mass, oil_hz, rate, hz, leakage=leakage)) < 0.006


@pytest.mark.parametrize(("mass", "oil_hz", "rate"), RIGS)
def test_a_wrongly_known_actuator_costs_little(mass, oil_hz, rate):
    for sign, delay in ((-1.0, -0.002), (-1.0, 0.002), (1.0, 0.002)):
        errors = {"gain_error": 0.1 * sign, "oil_error": 0.2 * sign, "dead_time_error": delay}
        assert error(scaled_test(mass, oil_hz, rate, 4.0, **errors)) < 0.012


@pytest.mark.parametrize(("mass", "oil_hz", "rate"), [(1000, 30, 4000), (10000, 8, 1000)])
def test_a_fast_valve_that_is_later_than_known_costs_little(mass, oil_hz, rate):
    """What is not known of the delay is most of it."""
    wrong = {"gain_error": -0.1, "oil_error": -0.2, "leakage": 30.0}
    words = scaled_rig(mass, oil_hz, rate, 2.0, **wrong)
    words += ["/**:actuator.valve_frequency:=130.0", "/**:actuator.dead_time:=0.0005"]
    words += ["rig:simulated.actuator.dead_time:=0.0025"]
    assert error(load(*words, config="demo")) < 0.012


@pytest.mark.parametrize(
    ("mass", "oil_hz", "rate"), [(20.0, 120.0, 500.0), RIGS[1], (800.0, 23.0, 500.0), RIGS[3]]
)
def test_preflight_calls_them_stable(mass, oil_hz, rate):
    test = PlannedTest(scaled_test(mass, oil_hz, rate, 2.0))
    found = check_stability(test)
    assert (found.verdict, found.reasons, folded(test)) == ("stable", [], "")


def test_the_oil_is_followed():
    errors = {"oil_error": 0.2, "gain_error": -0.1, "dead_time_error": 0.001}
    experiment = scaled_test(3000.0, 12.0, 1000.0, 4.0, **errors)
    blocks = build_blocks(experiment)
    assert simulate_test(experiment, blocks).trip is None
    gain, delay, compliance = blocks.force_controller.controller.state.errors[0]
    assert gain == pytest.approx(1 / 0.9 - 1, abs=0.01)
    assert delay == pytest.approx(-0.001, abs=2e-4)
    assert compliance == pytest.approx(0.2, abs=0.01)


def test_an_oil_column_that_is_too_fast_for_the_rate_is_warned_of():
    said = folded(PlannedTest(scaled_test(20.0, 200.0, 250.0, 2.0)))
    assert said.startswith("the oil column oscillates at 200 Hz, with less than 2.5 samples")
    assert said.endswith("take a rate of 500 Hz or more")


def foreseen(experiment):
    return yielding_error(experiment, expected_response(experiment, planned_motion(experiment)))


def test_the_error_of_an_unforeseen_yielding_is_that_of_its_test():
    planned = scaled_test(3000.0, 12.0, 500.0, 2.0)
    found = foreseen(planned)
    bilinear = scaled_test(3000.0, 12.0, 500.0, 2.0, kind="bilinear")
    own = error(bilinear.changed({"rig": {"simulated.specimen.hardening_ratio": 0.1}}))
    # the limits differ, and with them nothing that a test without a trip shows
    assert found.whole == pytest.approx(own, rel=1e-6)
    assert found.of_valve < 0.5 * found.whole < LARGEST_ERROR
    assert found.warning() == ""


def test_where_the_valve_cannot_follow_preflight_says_so():
    found = foreseen(scaled_test(20000.0, 6.0, 250.0, 8.0))
    assert found.of_valve > 2 * LARGEST_ERROR
    assert "the valve can't follow that fast" in found.warning()


def test_a_yielding_that_noise_spoils_is_distinguished_from_one_that_the_valve_spoils():
    assert YieldingError(0.02, 0.001).warning() == ""
    assert "is 2 % (0.1 % without noise)" in str(YieldingError(0.02, 0.001))
    assert "is that of a test that trips" in YieldingError(math.inf, math.inf).warning()


def test_no_yielding_is_simulated_where_none_can_be():
    planned = load(config="demo")
    response = expected_response(planned, planned_motion(planned))
    assert yielding_error(planned, None) is None
    obeys = planned.changed({"/**": {"actuator.kind": "ideal"}})
    assert yielding_error(obeys, response) is None
    frame = load(config="three_storey_frame")  # its storeys are not given as springs
    assert foreseen(frame) is None
    assert np.isfinite(foreseen(planned).whole)
