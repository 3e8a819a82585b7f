"""What was at the end of its range: counted, and told as text."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st
from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.messages import decode_status, encode_status
from seft_msgs_py.wire.outcome import Outcome, count_saturated, read_outcome, rig_status
from seft_msgs_py.wire.topics import Timebase

TIMEBASE = Timebase.from_rate(500.0)
NAMES = st.sampled_from(["valve", "stroke", "force_capacity", "force_range", "acceleration_range"])


def counted(steps):
    """Saturation after these names at steps 0, 1, ..."""
    saturation = {}
    for step, names in enumerate(steps):
        for name in set(names):
            count_saturated(saturation, name, 1, step)
    return saturation


def ended(saturation):
    """Last status of a rig."""
    return rig_status(Outcome("finished", 9, 0, [], 1.0, saturation=saturation))


@given(st.lists(st.lists(NAMES), max_size=30))
def test_each_name_has_the_number_of_its_samples_and_the_first(steps):
    saturation = counted(steps)
    seen = {name for names in steps for name in names}
    assert set(saturation) == seen
    for name in seen:
        at = [step for step, names in enumerate(steps) if name in names]
        assert saturation[name] == {"samples": len(at), "first_step": at[0]}


def test_the_text_is_json_in_the_order_of_names():
    text = ended(counted([["valve"], ["stroke", "valve"]])).values["saturated"]
    assert list(json.loads(text)) == ["stroke", "valve"]
    assert json.loads(text)["valve"] == {"samples": 2, "first_step": 0}
    assert ended({}).values["saturated"] == "{}"


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
    status = ended({})
    status.values["saturated"] = text
    with pytest.raises(WireError, match="status of the finished rig"):
        read_outcome(status, TIMEBASE)


@given(st.lists(st.lists(NAMES | st.text(st.characters(codec="utf-8"))), max_size=20))
def test_it_survives_the_rigs_last_status(steps):
    saturation = counted(steps)
    outcome = read_outcome(decode_status(encode_status(ended(saturation))), TIMEBASE)
    assert outcome.saturation == saturation


def test_a_driver_that_says_nothing_of_it_had_nothing_at_its_end():
    status = ended({})
    assert status.values.pop("saturated") == "{}"
    assert read_outcome(status, TIMEBASE).saturation == {}
