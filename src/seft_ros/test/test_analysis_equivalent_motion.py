"""The ground motion of which a test is the exact one, whatever was tested."""

import dataclasses
import json

import numpy as np
import pytest
from experiments_at_hand import load
from recordings_at_hand import recording_of, without
from seft_msgs_py.config.experiment import Experiment
from seft_plant_sim.whole_structure import reference_response, whole_structure
from seft_ros.analysis import equivalent_motion as equivalent
from seft_ros.analysis.metrics import delayed
from seft_ros.analysis.specimen_law import SpecimenLaw, springs_of
from seft_ros.analysis.summary import summarise
from seft_ros.bags.recording import Series

COUNT = 1500
CONFIGS = ("jhu", "three_storey_frame", "water_tower", "two_pier_bridge")
WITHOUT_FOLDING = {"/**": {"actuator.kind": "ideal"}}
FRICTION = {  # 45 times as stiff until it slips, at some 100 N
    "simulated.specimen.kind": "bilinear",
    "simulated.specimen.stiffness": 45 * 2.11e5,
    "simulated.specimen.hardening_ratio": 1 / 45,
    "simulated.specimen.yield_displacement": 1.1e-5,
}


def experiment(config="jhu", *words):
    return load("reference_force:mass_ratio:=1.0", *words, config=config)


METHOD = "reference_force:compensation.method:={}".format


def ground(test, seed=1):
    """Ground acceleration up to some 10 Hz, from rest to rest."""
    time = np.arange(COUNT) * test.timebase.dt
    hill = np.sin(np.pi * time / time[-1])[:, np.newaxis] ** 2
    noise = np.random.default_rng(seed).normal(size=(COUNT, len(test.axes)))
    low = np.exp(-((np.fft.rfftfreq(COUNT, test.timebase.dt) / 6.0) ** 2))[:, np.newaxis]
    return 20.0 * hill * np.fft.irfft(np.fft.rfft(noise, axis=0) * low, COUNT, axis=0)


def states_of(test, motion):
    """States of a perfect test under a ground motion."""
    return reference_response(test, motion).states


def equivalent_of(test, states):
    assumed = equivalent.assumed_structure(test)
    return equivalent.EquivalentMotion(whole_structure(assumed), test.timebase.dt).advance(states)


@pytest.mark.parametrize("config", CONFIGS)
def test_an_exact_test_is_of_the_ground_motion_that_was_asked_for(config):
    test = experiment(config)
    motion = ground(test)
    found = equivalent_of(test, states_of(test, motion))
    # internal degrees of freedom see the measured motion as linear between samples
    np.testing.assert_allclose(found, motion, atol=1e-4 * np.abs(motion).max())


@pytest.mark.parametrize("count", [2, 3, 6, 7, 20])
@pytest.mark.parametrize("config", CONFIGS)
def test_a_test_of_a_few_samples_has_a_summary(config, count):
    test = experiment(config)
    states = states_of(test, ground(test))[:count].copy()
    states[0, 0] = 0.0444  # of a sensor: the test trips at once
    summary = summarise(recording_of(test, ground(test)[:count], states))
    json.dumps(summary, allow_nan=False)


@pytest.mark.parametrize("size", [1e20, 1e60])
def test_a_test_that_went_unstable_has_a_summary(size):
    test = experiment()
    growth = np.geomspace(1.0, size, COUNT)[:, np.newaxis, np.newaxis]
    states = states_of(test, ground(test)) * growth
    json.dumps(summarise(recording_of(test, ground(test), states)), allow_nan=False)


@pytest.mark.parametrize("law", [FRICTION, {"simulated.specimen.kind": "bouc_wen"}])
def test_of_the_specimen_nothing_but_the_mass_counts(law):
    test = experiment().changed({"rig": {"simulated.specimen.yield_displacement": 0.002, **law}})
    motion = ground(test)
    found = equivalent_of(test, states_of(test, motion))
    np.testing.assert_allclose(found, motion, atol=1e-9 * np.abs(motion).max())


def test_a_known_error_of_force_is_a_known_error_of_ground_motion():
    test = experiment("three_storey_frame")
    states = states_of(test, ground(test))
    error = np.random.default_rng(3).normal(size=(COUNT, 3))
    wrong = states.copy()
    wrong[:, 3] += error
    whole = whole_structure(test)
    wanted = -np.linalg.solve(whole.structure.mass, error.T).T
    found = equivalent_of(test, wrong) - equivalent_of(test, states)
    np.testing.assert_allclose(found, wanted, atol=1e-12)


@pytest.mark.parametrize("config", CONFIGS)
def test_the_difference_is_the_error_of_a_linear_test(config):
    test = experiment(config).changed(WITHOUT_FOLDING)
    motion = ground(test)
    wrong = motion + 0.2 * ground(test, seed=2)
    recording = recording_of(test, motion, states_of(test, wrong))
    summary = summarise(recording)
    true, found = summary["displacement"]["nrmse"], summary["equivalent_motion"]
    assert true > 0.05
    assert found["response_nrmse"] == pytest.approx(true, rel=1e-3)
    assert found["specimen_response_nrmse"] == pytest.approx(true, rel=0.03)


def test_a_larger_motion_differs_as_much_everywhere():
    test = experiment("three_storey_frame").changed(WITHOUT_FOLDING)
    motion = ground(test)
    found = equivalent.motion_difference(recording_of(test, motion, states_of(test, 1.1 * motion)))
    assert found.specimen_nrmse == pytest.approx(0.1, rel=0.02)
    # the acceleration is smooth between samples, that of the reference is linear
    np.testing.assert_allclose(found.tested, 1.1 * found.asked, rtol=1e-3)
    assert found.numbers()["spectrum_deviation"] == pytest.approx(0.1, rel=1e-3)
    low, high = found.band_hz
    assert low < found.natural_hz[0] and found.natural_hz[-1] < high


def test_the_law_of_the_test_says_what_another_motion_would_have_done():
    """Friction slips and a gap closes, which a linear structure does not: it differs by 0.03."""
    gap = {
        "simulated.specimen.kind": "gap",
        "simulated.specimen.gap.width": 0.001,
        "simulated.specimen.gap.stiffness": 4e5,
    }
    for law, size in ((FRICTION, 0.0405), (gap, 0.0340)):
        test = experiment().changed({"rig": law})
        motion = ground(test)
        summary = summarise(recording_of(test, motion, states_of(test, 1.03 * motion)))
        assert summary["displacement"]["nrmse"] == pytest.approx(size, rel=0.01)
        found = summary["equivalent_motion"]["specimen_response_nrmse"]
        assert found == pytest.approx(size, rel=0.08)


def test_beyond_the_motion_of_the_test_the_law_pulls_back():
    """Noise may make the last corners of the curve fall."""
    test = experiment("three_storey_frame")
    motion, known = ground(test), equivalent.assumed_structure(test)
    whole, states, dt = whole_structure(known), states_of(test, motion), test.timebase.dt
    states[:, 3] += 1e3 * np.random.default_rng(1).normal(size=motion.shape)
    mass = equivalent.EquivalentMotion(whole, dt).mass
    law = SpecimenLaw(whole, mass, states, springs_of(known, whole), dt)
    assert law.difference(99.0 * motion) == pytest.approx(0.99, abs=0.05)


def test_a_specimen_without_stiffness_has_springs_to_the_ground():
    assumed = equivalent.assumed_structure(load("specimen.stiffness:=0.0"))
    np.testing.assert_array_equal(springs_of(assumed, whole_structure(assumed)), np.eye(1))


def test_samples_that_are_lost_are_bridged():
    test = experiment()
    motion = ground(test)
    recording = recording_of(test, motion, states_of(test, motion))
    recording = without(recording, "rig/state", [300, 301, 900])
    assert equivalent.motion_difference(recording).response_nrmse < 0.01


@pytest.mark.parametrize("what", ["no step 0", "no motion", "no structure", "not finite", "empty"])
def test_what_can_not_be_known_is_null(what):
    test = experiment()
    motion = ground(test)
    recording = recording_of(test, motion, states_of(test, motion))
    series = dict(recording.series)
    topic = "ground_motion" if what == "no motion" else "rig/state"
    cut = slice(COUNT, None) if what == "empty" else slice(1, None)
    if what in ("no step 0", "no motion", "empty"):
        series[topic] = Series(series[topic].steps[cut], series[topic].values[cut])
    elif what == "not finite":
        series[topic].values[-1, 2] = np.inf
    else:
        test = Experiment({"rig": test["rig"]})
    summary = summarise(dataclasses.replace(recording, series=series, experiment=test))
    assert summary["equivalent_motion"] is None
    json.dumps(summary, allow_nan=False)


def test_a_motion_of_zeros_has_no_difference_but_no_error_either():
    test = experiment()
    recording = recording_of(test, np.zeros((COUNT, 1)), np.zeros((COUNT, 4, 1)))
    found = summarise(recording)["equivalent_motion"]
    assert found["response_nrmse"] is found["spectrum_deviation"] is None
    json.dumps(found, allow_nan=False)


@pytest.mark.parametrize("config", CONFIGS)
def test_a_method_that_sends_ahead_is_held_against_what_it_meant(config):
    test = experiment(config, METHOD("model"))
    motion = ground(test)
    states = states_of(test, motion)
    force = states[:, 3]
    ahead = np.stack([delayed(y, -0.014, test.timebase.dt) for y in force.T], axis=1)
    recording = recording_of(test, motion, states, ahead[:, np.newaxis])
    assert equivalent.tracked_of(recording).derived
    found = equivalent.tracking_of(recording)
    for axis in test.axes:
        assert found[axis]["nrmse"] < 2e-4
    sent = experiment(config, METHOD("none"))
    recording = dataclasses.replace(recording, experiment=sent)
    assert not equivalent.tracked_of(recording).derived
    first = equivalent.tracking_of(recording)[test.axes[0]]
    assert first["delay_s"] == pytest.approx(14e-3, abs=5e-4)


def test_a_reference_force_with_a_target_tells_both_motion_and_force():
    test = experiment("jhu", METHOD("none"))
    states = states_of(test, ground(test))
    targets = np.stack([0.9 * states[:, 0], states[:, 1], states[:, 3]], axis=1)
    recording = recording_of(test, ground(test), states, targets)
    assert equivalent.tracking_error_of(recording)["nrmse"] == pytest.approx(0.1)
    assert equivalent.tracking_of(recording)["x"]["nrmse"] == 0.0
    assert summarise(recording)["tracking_error"]["nrmse"] == pytest.approx(0.1)
    assert equivalent.tracking_error_of(recording_of(test, ground(test), states)) is None


LENGTH = 3000
DT = 0.002
TIME = np.arange(LENGTH) * DT
STEPS = np.arange(LENGTH)
FORCE = 500 * np.exp(-(((TIME - 3.0) / 0.6) ** 2)) * np.sin(2 * np.pi * 6.0 * (TIME - 3.0))
VELOCITY = FORCE / 2000.0
NAMES = ["delay_s", "nrmse", "peak_error"]


def tracking(gain=1.0, delay=0.0, axes=("x",)):
    """A force that follows its reference with a gain and a delay; the motion is in phase."""
    states = np.zeros((LENGTH, 4, len(axes)))
    states[:, 1] = VELOCITY[:, np.newaxis]
    states[:, 3] = gain * delayed(FORCE, delay, DT)[:, np.newaxis]
    command = np.repeat(FORCE[:, np.newaxis, np.newaxis], len(axes), axis=2)
    test = Experiment({"rig": {"rate": 1 / DT, "axes": list(axes)}})
    return recording_of(test, np.zeros((LENGTH, len(axes))), states, command)


def test_a_known_delay_and_gain_are_reported():
    found = summarise(tracking(delay=0.0037))["tracking"]["x"]
    assert list(found) == NAMES
    assert found["delay_s"] == pytest.approx(0.0037, abs=1e-6)
    found = summarise(tracking(gain=1.05))["tracking"]["x"]
    assert found["delay_s"] == 0.0
    assert found["nrmse"] == pytest.approx(0.05)
    assert found["peak_error"] == pytest.approx(0.05)


def test_lost_samples_of_either_topic_are_bridged():
    whole = equivalent.tracking_of(tracking(1.05, 0.0037))["x"]
    test = without(tracking(1.05, 0.0037), "reference_force", [0, 700, 1500, 1501, LENGTH - 1])
    test = without(test, "rig/state", [1400, 1501, 1600])
    found = equivalent.tracking_of(test)["x"]
    assert found == pytest.approx(whole, rel=5e-3)


@pytest.mark.parametrize("topic", ["reference_force", "rig/state"])
def test_without_samples_everything_is_null(topic):
    found = summarise(without(tracking(), topic, STEPS))["tracking"]["x"]
    assert found == dict.fromkeys(NAMES)


@pytest.mark.parametrize("topic", ["reference_force", "rig/state"])
def test_against_a_force_that_is_zero_errors_are_null(topic):
    recording = tracking()
    recording.series[topic].values[:] = 0.0
    found = summarise(recording)["tracking"]["x"]
    assert found["delay_s"] is None
    none = {"reference_force": {"nrmse", "peak_error"}, "rig/state": set()}[topic]
    assert {name for name in NAMES[1:] if found[name] is None} == none
