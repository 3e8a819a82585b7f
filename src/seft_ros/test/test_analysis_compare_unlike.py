"""Tests of unlike rate, length or axes."""

import numpy as np
import pytest
from records_at_hand import shown
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import LOOP_TOPICS
from seft_ros.analysis.comparison import compare_records
from seft_ros.analysis.result_text import comparison_texts
from seft_ros.bags.record import (
    Record,
    Series,
)

SEED = {"x": 1.0, "y": 2.0, "z": 3.0}


def make_record(rate=500.0, seconds=0.2, axes=("x", "y"), start=0):
    """A record whose samples tell time, place and axis, whatever rate and axes it has."""
    steps = np.arange(start, round(seconds * rate))
    time = np.round(steps * (1e9 / rate)) * 1e-9
    series = {}
    for topic in LOOP_TOPICS:
        rows = np.arange(1.0, len(topic.quantities) + 1)
        columns = np.array([SEED[axis] for axis in axes])
        values = time[:, None, None] + rows[None, :, None] * columns
        series[topic.name] = Series(steps, values)
    return Record(Experiment({"rig": {"rate": rate, "axes": list(axes)}}), series)


@pytest.mark.parametrize(
    ("other", "told"),
    [
        ({"rate": 250.0}, "the rate is 500 Hz in the first and 250 Hz in the second"),
        ({"axes": ("x",)}, "the axes are x, y in the first and x in the second"),
        ({"axes": ("y", "x")}, "the axes are x, y in the first and y, x in the second"),
    ],
)
def test_rates_and_axes_must_be_the_same(other, told):
    with pytest.raises(InputError, match=told):
        compare_records(make_record(), make_record(**other))


def test_the_common_part_of_different_lengths_is_compared_and_both_are_told():
    result = compare_records(make_record(), make_record(seconds=0.1))
    assert result["length_s"] == {"a": 0.198, "b": 0.098}
    assert result["first_difference"]["b"] == "missing"
    assert result["first_value_difference"] is None
    assert result["topics"]["rig/state"]["compared"] == 50
    assert result["topics"]["rig/state"]["missing_b"] == 50


def test_the_first_value_that_differs_is_told_besides_a_sample_that_is_missing():
    b = make_record(start=3)
    b.series["valve_command"].values[20, 0, 0] = 77.0
    result = compare_records(make_record(), b)
    assert result["first_difference"]["step"] == 0
    assert result["first_value_difference"]["step"] == 23
    assert result["first_value_difference"]["topic"] == "valve_command"


def test_the_table_says_what_is_not_common():
    comparison = compare_records(make_record(), make_record(seconds=0.1))
    text = shown(comparison_texts(comparison), width=80)
    assert "lengths differ: 0.198 s in a, 0.098 s in b" in text
    assert "rig/state: 100 samples in a and 50 in b, 0 not in a, 50 not in b" in text
    assert "…" not in text
