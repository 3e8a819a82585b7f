import dataclasses
import json
import math

import numpy as np
import pytest
from seft_msgs_py.config.experiment import Experiment
from seft_ros.analysis.metrics import delayed
from seft_ros.analysis.summary import summarise
from seft_ros.analysis.tracking import tracking_of
from seft_ros.bags.record import Record, Series

COUNT = 3000
DT = 0.002
TIME = np.arange(COUNT) * DT
STEPS = np.arange(COUNT)
FORCE = 500 * np.exp(-(((TIME - 3.0) / 0.6) ** 2)) * np.sin(2 * np.pi * 6.0 * (TIME - 3.0))
VELOCITY = FORCE / 2000.0
NAMES = [
    "fei_amplitude",
    "fei_delay_s",
    "fei_frequency_hz",
    "tracking_indicator_end",
    "energy_error",
    "energy_error_j",
    "J",
]


def make_record(gain=1.0, delay=0.0, axes=("x",)):
    """A force that follows its reference with a gain and a delay; the motion is in phase."""
    states = np.zeros((COUNT, 4, len(axes)))
    states[:, 1] = VELOCITY[:, np.newaxis]
    states[:, 3] = gain * delayed(FORCE, delay, DT)[:, np.newaxis]
    command = np.repeat(FORCE[:, np.newaxis, np.newaxis], len(axes), axis=2)
    none = np.zeros((COUNT, 1, len(axes)))
    series = {
        "ground_motion": Series(STEPS, none),
        "rig/state": Series(STEPS, states),
        "reference_force": Series(STEPS, command),
        "valve_command": Series(STEPS, none.copy()),
    }
    return Record(Experiment({"rig": {"rate": 1 / DT, "axes": list(axes)}}), series)


def lost(record, topic, steps):
    series = record.series[topic]
    kept = ~np.isin(series.steps, steps)
    return dataclasses.replace(
        record, series={**record.series, topic: Series(series.steps[kept], series.values[kept])}
    )


def test_a_known_gain_and_delay_are_told():
    found = summarise(make_record(gain=1.05, delay=0.0037))["tracking"]["x"]
    assert list(found) == NAMES
    assert found["fei_amplitude"] == pytest.approx(1.05, rel=1e-3)
    assert found["fei_delay_s"] == pytest.approx(0.0037, abs=5e-6)
    assert found["fei_frequency_hz"] == pytest.approx(6.0, rel=0.01)
    assert found["J"]["J1"] == pytest.approx(3.7, abs=1e-3)
    assert found["tracking_indicator_end"] > 0
    # nothing is known of the whole structure here
    assert found["J"]["J4"] is None
    assert found["J"]["J7"] is None


def test_a_force_too_large_by_a_tenth_feeds_an_eleventh_of_the_input():
    found = tracking_of(make_record(gain=1.1), None)["x"]
    assert found["energy_error"] == pytest.approx(1 / 11)
    assert found["energy_error_j"] == pytest.approx(0.1 * DT * np.sum(FORCE * VELOCITY))
    assert found["tracking_indicator_end"] == pytest.approx(0.0, abs=1e-9)
    assert found["J"]["J2"] == pytest.approx(10.0)


def test_a_late_force_that_should_drive_the_motion_takes_energy_away():
    assert tracking_of(make_record(delay=0.0037), None)["x"]["energy_error"] < 0


def test_lost_samples_of_either_topic_are_bridged():
    whole = tracking_of(make_record(1.05, 0.0037), None)["x"]
    record = lost(make_record(1.05, 0.0037), "reference_force", [0, 700, 1500, 1501, COUNT - 1])
    record = lost(record, "rig/state", [1400, 1501, 1600])
    found = tracking_of(record, None)["x"]
    for name in NAMES[:-1]:
        assert found[name] == pytest.approx(whole[name], rel=5e-3), name
    for name in ("J1", "J2", "J3"):
        assert found["J"][name] == pytest.approx(whole["J"][name], rel=5e-3)


def test_of_several_axes_each_has_its_own():
    record = make_record(delay=0.0037, axes=("x", "y"))
    record.series["rig/state"].values[:, 3, 1] *= 0.5
    found = tracking_of(record, None)
    assert found["y"]["fei_amplitude"] == pytest.approx(0.5 * found["x"]["fei_amplitude"])
    assert list(found["y"]["J"]) == ["J1", "J2", "J3", "J5", "J8"]


@pytest.mark.parametrize("topic", ["reference_force", "rig/state"])
def test_without_samples_everything_is_null(topic):
    found = summarise(lost(make_record(), topic, STEPS))["tracking"]["x"]
    assert [found[name] for name in NAMES[:-1]] == [None] * 6
    assert [found["J"][name] for name in ("J1", "J2", "J3")] == [None] * 3


def test_a_test_that_blew_up_is_json():
    record = make_record()
    record.series["rig/state"].values[-1, 3] = math.inf
    found = json.loads(json.dumps(summarise(record), allow_nan=False))["tracking"]["x"]
    assert found["fei_delay_s"] is None
    assert found["J"]["J2"] is None


@pytest.mark.parametrize("scale", [1e-200, 1e200])
def test_forces_whose_squares_leave_the_numbers_are_told_all_the_same(scale):
    record = make_record(1.05, 0.0037)
    for topic in ("reference_force", "rig/state"):
        record.series[topic].values[...] *= scale
    found = tracking_of(record, None)["x"]
    plain = tracking_of(make_record(1.05, 0.0037), None)["x"]
    for name in ("fei_amplitude", "fei_delay_s", "tracking_indicator_end"):
        assert found[name] == pytest.approx(plain[name], rel=1e-9)
    assert found["J"]["J2"] == pytest.approx(plain["J"]["J2"])
