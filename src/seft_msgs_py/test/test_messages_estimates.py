import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.messages import (
    EstimatesCodec,
    Status,
    encode_diagnostics,
)
from seft_msgs_py.wire.topics import Timebase

rclpy_serialization = pytest.importorskip("rclpy.serialization")
from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402

AXES = ("north", "east")
TIMEBASE = Timebase.from_rate(500.0)
CODEC = EstimatesCodec(AXES, TIMEBASE)
FINITE = st.floats(allow_nan=False, allow_infinity=False)
NAMES = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\x00"))
ESTIMATES = st.dictionaries(NAMES, hnp.arrays(np.float64, 2, elements=FINITE), min_size=1)
GOOD = {"delay": np.array([0.0123, 0.0131]), "stiffness": np.array([2.11e5, 3.0e5])}


def bits(estimates):
    return {name: values.view(np.uint64).tolist() for name, values in estimates.items()}


@given(st.integers(0, 10**9), ESTIMATES)
def test_estimates_are_read_back_bit_for_bit_and_in_their_order(step, estimates):
    back_step, back = CODEC.decode(CODEC.encode(step, estimates))
    assert back_step == step
    assert list(back) == list(estimates)
    assert bits(back) == bits(estimates)


def test_every_ros_tool_sees_a_status_per_axis_with_the_values_by_name():
    raw = CODEC.encode(650, GOOD)
    message = rclpy_serialization.deserialize_message(raw, DiagnosticArray)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1, 300_000_000)
    assert [status.name for status in message.status] == [
        "reference_force: north",
        "reference_force: east",
    ]
    for axis, status in enumerate(message.status):
        assert status.level == b"\x00"
        told = {item.key: float(item.value) for item in status.values}
        assert told == {name: values[axis] for name, values in GOOD.items()}


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_refused_by_name_and_axis(value):
    with pytest.raises(WireError, match=f"delay of reference_force: east is {value}"):
        CODEC.encode(0, {"delay": np.array([0.01, value])})


@pytest.mark.parametrize(
    "estimates", [{}, {"delay": 0.01}, {"delay": np.zeros(3)}, {"delay": np.zeros((1, 2))}]
)
def test_estimates_that_do_not_fit_the_axes_are_refused(estimates):
    with pytest.raises(WireError, match="reference_force/estimates"):
        CODEC.encode(0, estimates)


def statuses(north, east, names=AXES):
    values = (north, east)
    return [
        Status(f"reference_force: {axis}", 0, "", values=v)
        for axis, v in zip(names, values, strict=True)
    ]


@pytest.mark.parametrize(
    ("stamp_ns", "sent", "reason"),
    [
        (1, statuses({"a": "1"}, {"a": "2"}), "not on the 500 Hz grid"),
        (0, [], "statuses are"),
        (0, statuses({"a": "1"}, {"a": "2"})[:1], "statuses are"),
        (0, statuses({"a": "1"}, {"a": "2"}, ("east", "north")), "statuses are"),
        (0, statuses({}, {}), "at least one"),
        (0, statuses({"a": "1"}, {"b": "2"}), "the same estimates"),
        (
            0,
            statuses({"a": "1"}, {"a": "2 ms"}),
            "a of reference_force: east is 2 ms, but must be a finite",
        ),
        (0, statuses({"a": "inf"}, {"a": "2"}), "a of reference_force: north is inf"),
    ],
)
def test_a_message_that_is_not_of_this_test_is_refused_with_the_reason(stamp_ns, sent, reason):
    with pytest.raises(WireError, match=reason):
        CODEC.decode(encode_diagnostics(stamp_ns, sent))
