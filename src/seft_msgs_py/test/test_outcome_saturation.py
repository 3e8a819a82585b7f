"""What was at the end of its range: counted, and told as text."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st
from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.messages import decode_status, encode_status
from seft_msgs_py.wire.outcome import Saturation, read_outcome, rig_status
from seft_msgs_py.wire.topics import Timebase

TIMEBASE = Timebase.from_rate(500.0)
NAMES = st.sampled_from(["valve", "stroke", "force_capacity", "force_range", "acceleration_range"])


def counted(steps):
    """Saturation after these names at steps 0, 1, ..."""
    saturation = Saturation()
    for step, names in enumerate(steps):
        saturation.add(step, names)
    return saturation


@given(st.lists(st.lists(NAMES), max_size=30))
def test_each_name_has_the_number_of_its_samples_and_the_first(steps):
    saturation = counted(steps)
    seen = {name for names in steps for name in names}
    assert set(saturation.samples) == set(saturation.first_step) == seen
    for name in seen:
        at = [step for step, names in enumerate(steps) if name in names]
        assert saturation.samples[name] == len(at)
        assert saturation.first_step[name] == at[0]


@given(st.lists(st.lists(NAMES | st.text()), max_size=20))
def test_text_is_read_back(steps):
    saturation = counted(steps)
    assert Saturation.from_json(saturation.to_json()) == saturation


def test_the_text_is_json_in_the_order_of_names():
    text = counted([["valve"], ["stroke", "valve"]]).to_json()
    assert list(json.loads(text)) == ["stroke", "valve"]
    assert json.loads(text)["valve"] == {"samples": 2, "first_step": 0}
    assert Saturation().to_json() == "{}"


@pytest.mark.parametrize(
    "text",
    [
        "",
        "no json",
        "[]",
        "3",
        '{"valve": 3}',
        '{"valve": {"samples": 3}}',
        '{"valve": {"samples": "many", "first_step": 0}}',
        '{"valve": {"samples": null, "first_step": 0}}',
    ],
)
def test_other_text_is_refused(text):
    with pytest.raises(ValueError):
        Saturation.from_json(text)


@given(st.lists(st.lists(NAMES), max_size=10))
def test_it_survives_the_rigs_last_status(steps):
    saturation = counted(steps)
    status = rig_status("finished", 9, 0, [], 1.0, saturation=saturation)
    outcome = read_outcome(decode_status(encode_status(status)), TIMEBASE)
    assert outcome.saturation == saturation


def test_a_driver_that_says_nothing_of_it_had_nothing_at_its_end():
    status = rig_status("finished", 9, 0, [], 1.0)
    assert status.values.pop("saturated") == "{}"
    assert read_outcome(status, TIMEBASE).saturation == Saturation()


def test_a_status_with_other_text_is_refused_as_a_whole():
    status = rig_status("finished", 9, 0, [], 1.0)
    status.values["saturated"] = "{"
    with pytest.raises(WireError, match="status of the finished rig"):
        read_outcome(status, TIMEBASE)


def test_two_tests_do_not_share_their_counts():
    one, other = Saturation(), Saturation()
    one.add(3, ["valve"])
    assert other.samples == {}
