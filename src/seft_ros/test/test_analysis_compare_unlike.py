"""Tests of unlike rate, length or axes, and more than two of them."""

import numpy as np
import pytest
from records_at_hand import shown
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import LOOP_TOPICS
from seft_ros.analysis.comparison import compare_all, compare_records
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
    ("rates", "common"), [((500.0, 250.0), 50), ((250.0, 500.0), 50), ((500.0, 400.0), 20)]
)
def test_at_different_rates_the_instants_that_both_have_are_compared(rates, common):
    result = compare_records(*map(make_record, rates))
    assert result["identical"] is False
    assert result["first_difference"] is None
    assert result["aligned_by"] == "time"
    assert result["rate_hz"] == dict(zip("ab", rates, strict=True))
    for row in result["topics"].values():
        assert row["samples_a"] == round(0.2 * rates[0])
        assert row["identical"] is True
        assert (row["compared"], row["missing_a"], row["missing_b"]) == (common, 0, 0)


def test_a_difference_at_different_rates_is_told_in_the_steps_of_both():
    a, b = make_record(500.0), make_record(400.0)
    b.series["reference_force"].values[8, 0, 1] = 77.0
    b.series["reference_force"].values[9, 0, 1] = 77.0  # where a has no sample
    first = compare_records(a, b)["first_difference"]
    assert (first["step"], first["step_b"]) == (10, 8)
    assert (first["topic"], first["axis"], first["b"]) == ("reference_force", "y", 77.0)
    assert compare_records(a, b)["topics"]["reference_force"]["missing_b"] == 0


@pytest.mark.parametrize("other", [make_record(400.0, 0.009), make_record(400.0, 0.2, start=79)])
def test_rates_without_common_instants_are_an_input_error(other):
    with pytest.raises(InputError, match=r"500 Hz .* 400 Hz .* no samples at the same times"):
        compare_records(make_record(500.0), other)


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


def test_common_axes_are_compared_by_name_and_the_others_told():
    result = compare_records(make_record(axes=("x", "y")), make_record(axes=("z", "y")))
    assert result["axes"] == {"compared": ["y"], "only_a": ["x"], "only_b": ["z"]}
    assert result["identical"] is False
    assert result["first_difference"] is None
    turned = compare_records(make_record(axes=("x", "y")), make_record(axes=("y", "x")))
    assert turned["identical"] is True


def test_without_a_common_axis_there_is_nothing_to_compare():
    with pytest.raises(InputError, match=r"no axis in common: axes are \['x'\] .* \['z'\]"):
        compare_records(make_record(axes=("x",)), make_record(axes=("z",)))


def test_further_records_are_each_compared_with_the_first():
    b, c = make_record(), make_record()
    c.series["rig/state"].values[7, 0, 0] = 77.0
    result = compare_all(["a", "b", "c"], [make_record(), b, c])
    assert result["identical"] is False
    assert [one["identical"] for one in result["comparisons"]] == [True, False]
    assert result["comparisons"][1]["first_difference"]["step"] == 7
    assert compare_all(["a", "b"], [make_record(), c]) == result["comparisons"][1]


def test_the_two_that_can_not_be_compared_are_named():
    records = [make_record(), make_record(), make_record(axes=("z",))]
    with pytest.raises(InputError, match=r"^bags/a and bags/c: the tests can't be compared"):
        compare_all(["bags/a", "bags/b", "bags/c"], records)


def table(*comparisons):
    return shown(comparison_texts(comparisons, "abc"[: 1 + len(comparisons)]), width=80)


def test_the_table_says_what_is_not_common():
    text = table(compare_records(make_record(), make_record(250.0, 0.1, ("y",))))
    assert "rates differ (500 Hz in a, 250 Hz in b)" in text
    assert "lengths differ: 0.198 s in a, 0.096 s in b" in text
    assert "axes differ: x only in a; compared: y" in text
    assert "…" not in text


def test_many_are_tabulated_by_quantity_side_by_side():
    c = make_record()
    c.series["rig/state"].values[:, 1] *= 1.5
    a, b = make_record(), make_record()
    text = table(compare_records(a, b), compare_records(a, c))
    row = next(line for line in text.splitlines() if "rig/state velocities" in line)
    assert [cell.strip() for cell in row.split("│")[2:4]] == ["0 %", "50.0 %"]
    assert "…" not in text
