import dataclasses
import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recordings_at_hand import noise_recording, shown
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import LOOP_TOPICS
from seft_ros.analysis.comparison import compare_recordings
from seft_ros.analysis.figures import comparison_figure
from seft_ros.analysis.result_text import comparison_texts
from seft_ros.bags.recording import Estimates, Series
from seft_ros.bags.recording_bag import write_recording

AXES = ("x", "y")
COUNT = 40
PLACES = [
    (topic, row, column)
    for topic in LOOP_TOPICS
    for row in range(len(topic.quantities))
    for column in range(len(AXES))
]


def make_recording(count=COUNT, rate=500.0, axes=AXES, missed=0, start=0):
    recording = noise_recording(COUNT, axes, rate, missed=missed)
    kept = np.arange(start, count)
    series = {name: whole.of_steps(kept) for name, whole in recording.series.items()}
    return dataclasses.replace(recording, series=series)


def test_the_same_samples_are_identical():
    result = compare_recordings(make_recording(), make_recording(missed=2))
    assert result["identical"] is True
    assert result["first_difference"] is None
    assert result["missed"] == {"a": 0, "b": 2}
    assert list(result["topics"]) == [topic.name for topic in LOOP_TOPICS]
    for row in result["topics"].values():
        assert (row["samples_a"], row["samples_b"]) == (COUNT, COUNT)
        assert (row["missing_a"], row["missing_b"]) == (0, 0)
        assert (row["max_abs"], row["nrmse"]) == (0.0, 0.0)


@settings(max_examples=30)
@given(place=st.sampled_from(PLACES), step=st.integers(0, COUNT - 1))
def test_one_bit_anywhere_is_a_difference_and_is_named(place, step):
    topic, row, column = place
    a, b = make_recording(), make_recording()
    value = float(b.series[topic.name].values[step, row, column])
    beside = b.series[topic.name].values[step, row, column] = np.nextafter(value, np.inf)
    result = compare_recordings(a, b)
    assert result["identical"] is False
    found = {"topic": topic.name, "step": step, "field": topic.quantities[row]}
    expected = found | {"axis": AXES[column], "a": value, "b": beside}
    assert result["first_difference"] == expected
    swapped = compare_recordings(b, a)["first_difference"]
    assert (swapped["a"], swapped["b"]) == (beside, value)


@settings(max_examples=30)
@given(st.lists(st.tuples(st.sampled_from(PLACES), st.integers(0, COUNT - 1)), min_size=1))
def test_the_smallest_step_comes_first_then_the_order_of_the_topics(changes):
    a, b = make_recording(), make_recording()
    for (topic, row, column), step in changes:
        b.series[topic.name].values[step, row, column] = 77.0
    step, place = min((step, PLACES.index(place)) for place, step in changes)
    topic, row, column = PLACES[place]
    first = compare_recordings(a, b)["first_difference"]
    found = (first["step"], first["topic"], first["field"], first["axis"])
    assert found == (step, topic.name, topic.quantities[row], AXES[column])


def test_a_zero_of_the_other_sign_is_not_the_same_bits():
    a, b = make_recording(), make_recording()
    a.series["valve_command"].values[3] = 0.0
    b.series["valve_command"].values[3] = -0.0
    result = compare_recordings(a, b)
    assert result["identical"] is False
    assert result["first_difference"]["step"] == 3
    assert result["topics"]["valve_command"]["max_abs"] == 0.0


def test_the_same_nan_is_the_same_and_the_result_is_json():
    a, b = make_recording(), make_recording()
    for recording in (a, b):
        recording.series["rig/state"].values[5] = math.nan
    assert compare_recordings(a, b)["identical"] is True
    b.series["rig/state"].values[5] = math.inf
    result = json.loads(json.dumps(compare_recordings(a, b), allow_nan=False))
    assert result["identical"] is False
    assert result["topics"]["rig/state"]["max_abs"] is None


def test_errors_are_reported_of_each_field_and_the_largest_of_the_topic():
    a, b = make_recording(), make_recording()
    values = a.series["rig/state"].values
    b.series["rig/state"].values[:, 0] *= 1.5
    b.series["rig/state"].values[7, 3, 1] += 10.0
    row = compare_recordings(a, b)["topics"]["rig/state"]
    assert row["fields"]["positions"]["nrmse"] == pytest.approx(0.5)
    assert row["fields"]["velocities"] == {"max_abs": 0.0, "nrmse": 0.0}
    rms = np.sqrt(np.mean(values[:, 3] ** 2))
    assert row["fields"]["effort"]["nrmse"] == pytest.approx(10.0 / np.sqrt(80) / rms)
    assert row["max_abs"] == pytest.approx(10.0)
    assert row["nrmse"] == pytest.approx(max(0.5, 10.0 / np.sqrt(80) / rms))


def test_recordings_without_a_common_step_are_compared():
    result = compare_recordings(make_recording(0), make_recording())
    assert result["first_difference"]["step"] == 0
    assert result["topics"]["rig/state"]["missing_a"] == 40
    assert compare_recordings(make_recording(0), make_recording(0))["identical"] is True


@pytest.mark.parametrize(
    ("other", "message"),
    [
        ({"rate": 250.0}, "the rate is 500 Hz in the first and 250 Hz in the second"),
        ({"axes": ("x",)}, "the axes are x, y in the first and x in the second"),
        ({"axes": ("y", "x")}, "the axes are x, y in the first and y, x in the second"),
    ],
)
def test_rates_and_axes_must_be_the_same(other, message):
    with pytest.raises(InputError, match=message):
        compare_recordings(make_recording(), make_recording(**other))


def test_the_common_part_of_different_lengths_is_compared_and_both_are_reported():
    result = compare_recordings(make_recording(), make_recording(20))
    assert result["length_s"] == {"a": 0.078, "b": 0.038}
    assert result["first_difference"]["b"] == "missing"
    assert result["first_value_difference"] is None
    assert result["topics"]["rig/state"]["compared"] == 20
    assert result["topics"]["rig/state"]["missing_b"] == 20
    text = shown(comparison_texts(result), width=80)
    assert "lengths differ: 0.078 s in a, 0.038 s in b" in text
    assert "rig/state: 40 samples in a and 20 in b, 0 not in a, 20 not in b" in text
    assert "…" not in text


def test_the_first_value_that_differs_is_reported_besides_a_sample_that_is_missing():
    b = make_recording(start=3)
    b.series["valve_command"].values[20, 0, 0] = 77.0
    result = compare_recordings(make_recording(), b)
    assert result["first_difference"]["step"] == 0
    assert result["first_value_difference"]["step"] == 23
    assert result["first_value_difference"]["topic"] == "valve_command"


def test_both_tests_are_drawn_with_their_difference_its_first_mark_and_gaps():
    a, b = make_recording(), make_recording()
    b.series["valve_command"].values[20] += 1.0
    kept = np.setdiff1d(np.arange(COUNT), range(30, 35))
    b.series.update({name: series.of_steps(kept) for name, series in b.series.items()})
    figure = comparison_figure(a, b, compare_recordings(a, b), ["a: bag", "b: bag"])
    figure.canvas.draw()
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert legend == ["a: bag", "b: bag", "first difference: valve_command, 0.04 s"]
    labels = [panel.get_ylabel() for panel in figure.axes]
    assert labels[0] == "displacement / mm"
    assert len(labels) == 6
    assert all(label.startswith("difference") for label in labels[1::2])
    assert figure.texts[0].get_text().startswith("axis x")
    (line,) = (line for line in figure.axes[1].lines if len(line.get_xdata()) > 2)
    assert np.isnan(line.get_ydata()).sum() == 1


ESTIMATES = Estimates(np.array([0, 20]), np.arange(8.0).reshape(2, 2, 2), ("delay", "gain"))
NAME = "reference_force/estimates"


def estimating(estimates=ESTIMATES):
    return dataclasses.replace(make_recording(), estimates=estimates)


def test_estimates_are_compared_like_samples():
    same = compare_recordings(estimating(), estimating())
    assert same["identical"] is True
    assert same["topics"][NAME]["samples_a"] == 2
    values = ESTIMATES.values.copy()
    values[1, 1, 0] += 3.0
    other = dataclasses.replace(ESTIMATES, values=values)
    result = compare_recordings(estimating(), estimating(other))
    where = {"topic": NAME, "step": 20, "field": "gain", "axis": "x"}
    assert result["first_difference"] == where | {"a": 6.0, "b": 9.0}
    assert result["topics"][NAME]["max_abs"] == 3.0
    assert result["topics"][NAME]["fields"]["delay"]["max_abs"] == 0.0


def test_estimates_are_distinguished_by_name_and_not_by_place():
    turned = Estimates(ESTIMATES.steps, ESTIMATES.values[:, ::-1], ("gain", "delay"))
    assert compare_recordings(estimating(), estimating(turned))["identical"] is True
    fewer = Estimates(ESTIMATES.steps, ESTIMATES.values[:, :1], ("delay",))
    first = compare_recordings(estimating(), estimating(fewer))["first_difference"]
    assert (first["field"], first["a"], first["b"]) == ("gain", 2.0, None)


def table(result):
    return shown(comparison_texts(result))


def test_the_table_says_where_recordings_first_differ():
    a, b = make_recording(), make_recording(missed=3)
    same = "identical, bit for bit; steps that missed the command deadline: 3 in b"
    assert same in table(compare_recordings(a, b))
    b.series["rig/state"].values[3, 3, 1] = 77.0
    text = table(compare_recordings(a, b))
    assert "first difference at step 3, rig/state, effort of axis y" in text
    assert "77.0 in b" in text
    assert "the sample is missing in b" in table(compare_recordings(a, make_recording(5)))


# ---- `seft compare` on bags; of what they may be, see test_bags_record_bag_reader.py


def test_two_bags_are_drawn(seft, tmp_path):
    recording = noise_recording(60)
    write_recording(recording, tmp_path / "one")
    values = recording.series["rig/state"].values.copy()
    values[41, 3, 1] = np.nextafter(values[41, 3, 1], np.inf)
    altered = {**recording.series, "rig/state": Series(np.arange(60), values)}
    write_recording(dataclasses.replace(recording, series=altered), tmp_path / "two")
    status, out, err = seft("compare", "one", "two", "--figure", "tests.png", "--json")
    result = json.loads(out)
    assert (status, err, result["identical"]) == (1, "", False)
    assert [bag["bag"] for bag in result["bags"]] == ["one", "two"]
    assert result["figure"] == "tests.png"
    assert (tmp_path / "tests.png").read_bytes().startswith(b"\x89PNG")
    status, out, _ = seft("compare", "one", "two")
    assert status == 1
    assert "first difference at step 41, rig/state" in out
