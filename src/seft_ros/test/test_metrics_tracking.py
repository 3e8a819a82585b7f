import numpy as np
import pytest
from recordings_at_hand import recording_of, without
from seft_msgs_py.config.experiment import Experiment
from seft_ros.analysis.equivalent_motion import tracking_of
from seft_ros.analysis.metrics import delayed
from seft_ros.analysis.summary import summarise

COUNT = 3000
DT = 0.002
TIME = np.arange(COUNT) * DT
STEPS = np.arange(COUNT)
FORCE = 500 * np.exp(-(((TIME - 3.0) / 0.6) ** 2)) * np.sin(2 * np.pi * 6.0 * (TIME - 3.0))
VELOCITY = FORCE / 2000.0
NAMES = ["delay_s", "nrmse", "peak_error"]


def make_recording(gain=1.0, delay=0.0, axes=("x",)):
    """A force that follows its reference with a gain and a delay; the motion is in phase."""
    states = np.zeros((COUNT, 4, len(axes)))
    states[:, 1] = VELOCITY[:, np.newaxis]
    states[:, 3] = gain * delayed(FORCE, delay, DT)[:, np.newaxis]
    command = np.repeat(FORCE[:, np.newaxis, np.newaxis], len(axes), axis=2)
    test = Experiment({"rig": {"rate": 1 / DT, "axes": list(axes)}})
    return recording_of(test, np.zeros((COUNT, len(axes))), states, command)


def test_a_known_delay_and_gain_are_reported():
    found = summarise(make_recording(delay=0.0037))["tracking"]["x"]
    assert list(found) == NAMES
    assert found["delay_s"] == pytest.approx(0.0037, abs=1e-6)
    found = summarise(make_recording(gain=1.05))["tracking"]["x"]
    assert found["delay_s"] == 0.0
    assert found["nrmse"] == pytest.approx(0.05)
    assert found["peak_error"] == pytest.approx(0.05)


def test_lost_samples_of_either_topic_are_bridged():
    whole = tracking_of(make_recording(1.05, 0.0037))["x"]
    test = without(make_recording(1.05, 0.0037), "reference_force", [0, 700, 1500, 1501, COUNT - 1])
    test = without(test, "rig/state", [1400, 1501, 1600])
    found = tracking_of(test)["x"]
    assert found == pytest.approx(whole, rel=5e-3)


@pytest.mark.parametrize("topic", ["reference_force", "rig/state"])
def test_without_samples_everything_is_null(topic):
    found = summarise(without(make_recording(), topic, STEPS))["tracking"]["x"]
    assert found == dict.fromkeys(NAMES)


@pytest.mark.parametrize("topic", ["reference_force", "rig/state"])
def test_against_a_force_that_is_zero_errors_are_null(topic):
    recording = make_recording()
    recording.series[topic].values[:] = 0.0
    found = summarise(recording)["tracking"]["x"]
    assert found["delay_s"] is None
    none = {"reference_force": {"nrmse", "peak_error"}, "rig/state": set()}[topic]
    assert {name for name in NAMES[1:] if found[name] is None} == none
