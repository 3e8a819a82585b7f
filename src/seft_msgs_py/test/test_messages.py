import contextlib
import json
import struct

import numpy as np
import pytest
from damaged_messages import damaged
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from seft_msgs_py.errors import WireError
from seft_msgs_py.wire import messages
from seft_msgs_py.wire.experiment_state import ExperimentState, decode_state, encode_state
from seft_msgs_py.wire.outcome import State
from seft_msgs_py.wire.topics import GROUND_MOTION, LOOP_TOPICS, MEASURED, Timebase
from seft_msgs_py.wire.trajectory import TrajectoryCodec

rclpy_serialization = pytest.importorskip("rclpy.serialization")
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from std_msgs.msg import String  # noqa: E402

serialise = rclpy_serialization.serialize_message
deserialise = rclpy_serialization.deserialize_message

TEXT = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\x00"))
STATUS = st.builds(
    messages.Status,
    name=TEXT,
    level=st.integers(0, 3),
    message=TEXT,
    hardware_id=TEXT,
    values=st.dictionaries(TEXT, TEXT, max_size=4),
)
STAMP = st.integers(0, 2**31 * 10**9 - 1)
DECODERS = (
    messages.decode_string,
    messages.decode_status,
    messages.decode_diagnostics,
    messages.decode_clock,
)
VALUES = {"missed": "3", "phase": "running"}
RIG = messages.Status("rig", messages.WARN, "3 steps late", "paper's rig", VALUES)
ENCODED = (
    messages.encode_string("größer"),
    messages.encode_status(RIG),
    messages.encode_diagnostics(5, [RIG, RIG]),
    messages.encode_clock(7_000_000_001),
)


def ros_status(status):
    return DiagnosticStatus(
        level=bytes([status.level]),
        name=status.name,
        message=status.message,
        hardware_id=status.hardware_id,
        values=[KeyValue(key=key, value=value) for key, value in status.values.items()],
    )


@given(TEXT)
def test_text_has_the_bytes_that_rclpy_writes(text):
    assert messages.encode_string(text) == serialise(String(data=text))
    assert messages.decode_string(messages.encode_string(text)) == text


@given(STAMP)
def test_clock_has_the_bytes_that_rclpy_writes(stamp):
    clock = Clock()
    clock.clock.sec, clock.clock.nanosec = divmod(stamp, 10**9)
    assert messages.encode_clock(stamp) == serialise(clock)
    assert messages.decode_clock(messages.encode_clock(stamp)) == stamp


@given(STATUS)
def test_status_is_read_alike_by_rclpy_and_here(status):
    assert deserialise(messages.encode_status(status), DiagnosticStatus) == ros_status(status)
    assert messages.decode_status(serialise(ros_status(status))) == status
    assert len(messages.encode_status(status)) == len(serialise(ros_status(status)))


@given(STAMP, st.lists(STATUS, max_size=3))
def test_diagnostics_are_read_alike_by_rclpy_and_here(stamp, statuses):
    ours = messages.encode_diagnostics(stamp, statuses)
    theirs = DiagnosticArray(status=[ros_status(status) for status in statuses])
    theirs.header.stamp.sec, theirs.header.stamp.nanosec = divmod(stamp, 10**9)
    assert deserialise(ours, DiagnosticArray) == theirs
    assert messages.decode_diagnostics(serialise(theirs)) == (stamp, statuses)


@pytest.mark.parametrize("padding", [b"\x00", b"\x00\x00\x00", b"garbage that a middleware left"])
def test_bytes_past_the_end_are_ignored(padding):
    for decode, raw in zip(DECODERS, ENCODED, strict=True):
        assert decode(raw + padding) == decode(raw)


def test_big_endian_messages_are_read():
    assert messages.decode_clock(b"\x00\x00\x00\x00" + struct.pack(">iI", 3, 4)) == 3_000_000_004


def test_of_keys_that_come_twice_the_last_counts():
    twice = DiagnosticStatus(values=[KeyValue(key="a", value="1"), KeyValue(key="a", value="2")])
    assert messages.decode_status(serialise(twice)).values == {"a": "2"}


def test_every_truncation_is_refused():
    for decode, raw in zip(DECODERS, ENCODED, strict=True):
        for end in range(len(raw)):
            with pytest.raises(WireError):
                decode(raw[:end])


@pytest.mark.parametrize(
    "encode",
    [
        lambda: messages.encode_string(b"bytes"),
        lambda: messages.encode_string("nul \x00"),
        lambda: messages.encode_string("surrogate \ud800"),
        lambda: messages.encode_clock(1.0),
        lambda: messages.encode_clock(np.int64(1)),
        lambda: messages.encode_clock(2**31 * 10**9),
        lambda: messages.encode_status({"name": "rig"}),
        lambda: messages.encode_status(messages.Status("rig", True, "")),
        lambda: messages.encode_status(messages.Status("rig", 4, "")),
        lambda: messages.encode_status(messages.Status("rig", np.int64(0), "")),
        lambda: messages.encode_status(messages.Status("rig", 0, None)),
        lambda: messages.encode_status(messages.Status("rig", 0, "", values={"missed": 3})),
        lambda: messages.encode_status(messages.Status("rig", 0, "", values={3: "missed"})),
        lambda: messages.encode_diagnostics(0, [None]),
    ],
)
def test_a_wrong_python_type_is_refused_not_corrupted(encode):
    with pytest.raises(WireError):
        encode()


@pytest.mark.parametrize("decode", DECODERS)
@pytest.mark.parametrize("raw", [None, "text", 3, [1, 2, 3, 4]])
def test_only_bytes_are_decoded(decode, raw):
    with pytest.raises(WireError):
        decode(raw)


AXES = ("north", "east")
TIMEBASE = Timebase.from_rate(500.0)
CODEC = messages.EstimatesCodec(AXES, TIMEBASE)
FINITE = st.floats(allow_nan=False, allow_infinity=False)
ESTIMATES = st.dictionaries(TEXT, hnp.arrays(np.float64, 2, elements=FINITE), min_size=1)
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
    message = deserialise(raw, DiagnosticArray)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1, 300_000_000)
    assert [status.name for status in message.status] == [
        "reference_force: north",
        "reference_force: east",
    ]
    for axis, status in enumerate(message.status):
        assert status.level == b"\x00"
        expected = {item.key: float(item.value) for item in status.values}
        assert expected == {name: values[axis] for name, values in GOOD.items()}


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
        messages.Status(f"reference_force: {axis}", 0, "", values=v)
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
        (0, statuses({"a": "1"}, {"a": "2 ms"}), "a of reference_force: east is 2 ms, but must be"),
        (0, statuses({"a": "inf"}, {"a": "2"}), "a of reference_force: north is inf"),
    ],
)
def test_a_message_that_is_not_of_this_test_is_refused_with_the_reason(stamp_ns, sent, reason):
    with pytest.raises(WireError, match=reason):
        CODEC.decode(messages.encode_diagnostics(stamp_ns, sent))


# ---- whatever bytes come on a topic, decoders give a value or the project's own error

CODECS = [TrajectoryCodec(topic, AXES, TIMEBASE) for topic in LOOP_TOPICS]
DESCRIBED = json.dumps({"node": "rig", "parameters": {"rate": 500.0}})

ANY_DECODERS = {
    "status": (messages.decode_status, messages.encode_status(RIG)),
    "state": (decode_state, encode_state(ExperimentState(State.RUNNING, "running", 9))),
    "diagnostics": (messages.decode_diagnostics, messages.encode_diagnostics(5, [RIG, RIG])),
    "string": (messages.decode_string, messages.encode_string("some text")),
    "clock": (messages.decode_clock, messages.encode_clock(10**9)),
    "description": (messages.decode_description, messages.encode_string(DESCRIBED)),
    "estimates": (CODEC.decode, CODEC.encode(3, GOOD)),
    **{
        codec.topic.name: (codec.decode, codec.encode(3, np.ones((len(codec.topic.quantities), 2))))
        for codec in CODECS
    },
    "motion ahead": (CODECS[0].decode, CODECS[0].encode_points(3, np.ones((5, 1, 2)))),
}
LOOP_DECODERS = [codec.decode for codec in CODECS]
assert CODECS[0].topic is GROUND_MOTION

few = settings(max_examples=60, suppress_health_check=list(HealthCheck))


@few
@pytest.mark.parametrize("name", ANY_DECODERS)
@given(data=st.data(), raw=st.binary(max_size=200))
def test_decoders_raise_nothing_but_wire_errors(name, data, raw):
    decode, good = ANY_DECODERS[name]
    for one in (raw, good[:4] + raw, damaged(data, good)):
        with contextlib.suppress(WireError):
            found = decode(one)
            if decode in LOOP_DECODERS:
                step, values = found
                assert step >= 0
                assert name == MEASURED.name or np.isfinite(values).all()  # a sensor may fail
