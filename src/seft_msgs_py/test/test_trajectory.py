import struct

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from seft_msgs_py.errors import InputError, WireError
from seft_msgs_py.wire import topics
from seft_msgs_py.wire.messages import typestore
from seft_msgs_py.wire.trajectory import TrajectoryCodec, decode_batch

serialization = pytest.importorskip("rclpy.serialization")
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint  # noqa: E402

TIMEBASE = topics.Timebase.from_rate(500.0)
DAYS = 7 * 24 * 3600 * 500  # in steps
LETTERS = st.characters(exclude_categories=["Cs"], exclude_characters="\x00")
AXES = st.lists(st.text(LETTERS, min_size=1), min_size=1, max_size=12, unique=True)
FINITE = st.floats(allow_nan=False, allow_infinity=False)
NOT_FINITE = st.sampled_from([np.nan, np.inf, -np.inf])


@st.composite
def messages(draw, most_points=4):
    """A codec, a step, and values of shape (p, q, n)."""
    timebase = draw(st.sampled_from([TIMEBASE, topics.Timebase.from_rate(4096.0)]))
    topic = draw(st.sampled_from((*topics.LOOP_TOPICS, topics.TARGET)))
    codec = TrajectoryCodec(topic, draw(AXES), timebase)
    count = 1 if topics.DRIVE in codec.topic.quantities else draw(st.integers(1, most_points))
    shape = count, len(codec.topic.quantities), len(codec.axes)
    return codec, draw(st.integers(0, DAYS)), draw(arrays(np.float64, shape, elements=FINITE))


def fields_of(codec, values):
    """The points on the wire: whether it is suspect and what a rig applies are a second one."""
    points = [dict(zip(codec.topic.quantities, point, strict=True)) for point in values]
    return points + [
        {"positions": point.pop(topics.IS_SUSPECT), "effort": point.pop(topics.DRIVE)}
        for point in points
        if topics.DRIVE in point
    ]


def cdr(codec, step, values, pad=b"\x00", end=b"", frame_id="", options=b"\x00\x00"):
    """The message by the CDR rules, one field after another; padding is filled with ``pad``."""
    out = bytearray(b"\x00\x01" + options)

    def put(form, *items, align):
        out.extend(pad * (-(len(out) - 4) % align))
        out.extend(struct.pack("<" + form, *items))

    def text(value):
        data = value.encode() + b"\x00"
        put("I", len(data), align=4)
        out.extend(data)

    stamp = codec.timebase.stamp_ns(step)
    put("iI", stamp // 10**9, stamp % 10**9, align=4)
    text(frame_id)
    put("I", len(codec.axes), align=4)
    for axis in codec.axes:
        text(axis)
    points = fields_of(codec, values)
    put("I", len(points), align=4)
    for index, point in enumerate(points):
        for quantity in topics.QUANTITIES:
            given = point.get(quantity, ())
            put("I", len(given), align=4)
            for value in given:
                put("d", value, align=8)
        after = codec.timebase.stamp_ns(index)
        put("iI", after // 10**9, after % 10**9, align=4)
    return bytes(out) + end


def ros_message(codec, step, values):
    message = JointTrajectory(joint_names=list(codec.axes))
    stamp = message.header.stamp
    stamp.sec, stamp.nanosec = divmod(codec.timebase.stamp_ns(step), 10**9)
    for index, point in enumerate(fields_of(codec, values.tolist())):
        ros = JointTrajectoryPoint(**point)
        ros.time_from_start.nanosec = codec.timebase.stamp_ns(index)
        message.points.append(ros)
    return message


def assert_decodes(codec, raw, step, values):
    got_step, got = codec.decode(raw)
    assert got_step == step
    assert got.shape == values.shape
    assert got.tobytes() == values.tobytes()


@given(messages())
def test_rclpy_and_rosbags_read_the_samples_as_they_are(message):
    codec, step, values = message
    raw = codec.encode_points(step, values)
    expected = ros_message(codec, step, values)
    assert serialization.deserialize_message(raw, JointTrajectory) == expected
    found = typestore().deserialize_cdr(raw, topics.JOINT_TRAJECTORY)
    for point, wanted in zip(found.points, expected.points, strict=True):
        for name in topics.QUANTITIES:
            assert getattr(point, name).tolist() == list(getattr(wanted, name))


@given(messages())
def test_the_bytes_follow_the_rules_of_cdr(message):
    codec, step, values = message
    assert codec.encode_points(step, values) == cdr(codec, step, values)


@given(messages(), st.binary(max_size=9))
def test_what_rclpy_writes_is_read(message, end):
    codec, step, values = message
    ros = serialization.serialize_message(ros_message(codec, step, values))
    assert_decodes(codec, ros + end, step, values)


@given(messages(), st.binary(min_size=1, max_size=1), st.binary(max_size=40))
def test_garbage_in_padding_and_past_the_end_is_ignored(message, pad, end):
    codec, step, values = message
    assert_decodes(codec, cdr(codec, step, values, pad, end), step, values)


@pytest.mark.parametrize("shape", [(3,), (1, 3), (1, 1, 3)])
def test_one_quantity_may_leave_out_its_dimension(shape):
    codec = TrajectoryCodec(topics.REFERENCE_FORCE, ("x", "y", "z"), TIMEBASE)
    values = np.array([1.0, 2.0, 3.0]).reshape(shape)
    assert_decodes(codec, codec.encode(4, values), 4, values.reshape(1, 1, 3))


TYPES = (np.int64, np.float32, np.complex128, ">f8", bool, str)
SHAPES = ((), (0,), (2,), (4,), (3, 1), (2, 2), (1, 3, 1), (0, 3), (3, 0))


@pytest.mark.parametrize(
    "values",
    [1, 1.0, None, [1.0, 2.0, 3.0], *(np.ones(3, t) for t in TYPES), *map(np.zeros, SHAPES)],
)
def test_another_type_or_shape_is_refused_not_corrupted(values):
    codec = TrajectoryCodec(topics.REFERENCE_FORCE, ("x", "y", "z"), TIMEBASE)
    with pytest.raises(WireError, match="reference_force"):
        codec.encode(0, values)
    with pytest.raises(WireError, match="reference_force"):
        codec.encode_points(0, values)


def test_points_on_three_axes_are_not_mistaken_for_three_axes():
    codec = TrajectoryCodec(topics.GROUND_MOTION, ("x", "y", "z"), TIMEBASE)
    with pytest.raises(WireError, match="shape"):
        codec.encode_points(0, np.zeros(3))


@given(messages(), NOT_FINITE, st.data())
def test_nan_and_inf_are_refused_both_ways_by_axis_and_quantity(message, value, data):
    codec, step, values = message
    point, row, column = (data.draw(st.integers(0, size - 1)) for size in values.shape)
    assume(codec.topic.finite)
    values[point, row, column] = value
    expected = f"{codec.topic.quantities[row]} of axis {codec.axes[column]} is {value}"
    for attempt in (
        lambda: codec.encode_points(step, values),
        lambda: codec.decode(cdr(codec, step, values)),
        lambda: codec.decode(cdr(codec, step, values, pad=b"\xa5")),
        lambda: codec.decode(cdr(codec, step, values, frame_id="slow way")),
    ):
        with pytest.raises(WireError) as caught:
            attempt()
        assert str(InputError(expected)) in str(caught.value)


@pytest.mark.parametrize("other", [("y", "x"), ("x",), ("x", "y", "z"), ("x", "Y"), ("x", "y ")])
@pytest.mark.parametrize("topic", topics.LOOP_TOPICS, ids=lambda topic: topic.name)
def test_other_axes_are_refused_with_both_lists(topic, other):
    theirs = TrajectoryCodec(topic, other, TIMEBASE)
    ours = TrajectoryCodec(topic, ("x", "y"), TIMEBASE)
    values = np.zeros((1, len(topic.quantities), len(other)))
    with pytest.raises(WireError) as caught:
        ours.decode(theirs.encode_points(0, values))
    assert f"axes are {list(other)}, not ['x', 'y']" in str(caught.value)


@pytest.mark.parametrize("points", [1, 2, 20])
@pytest.mark.parametrize("axes", [("x",), ("north", "east", "up")])
def test_the_force_of_a_target_is_read_by_who_does_not_know_of_it(monkeypatch, points, axes):
    target, force = (
        TrajectoryCodec(topic, axes, TIMEBASE) for topic in (topics.TARGET, topics.REFERENCE_FORCE)
    )
    values = np.random.default_rng(1).normal(size=(points, 3, len(axes)))
    raw = target.encode_points(7, values)
    step, slowly = force._decode_slowly(raw)
    monkeypatch.setattr(force, "_decode_slowly", lambda raw: pytest.fail("slow"))
    assert_decodes(force, raw, 7, values[:, 2:])
    np.testing.assert_array_equal(slowly, values[:, 2:])
    assert step == 7
    with pytest.raises(WireError, match=f"0 positions for {len(axes)} axes"):
        target.decode(force.encode_points(7, values[:, 2:]))


@pytest.mark.parametrize(("theirs", "step"), [(1000.0, 1), (512.0, 1), (400.0, 3)])
def test_samples_of_another_rate_are_refused(theirs, step):
    sender = TrajectoryCodec(topics.REFERENCE_FORCE, ("x",), topics.Timebase.from_rate(theirs))
    receiver = TrajectoryCodec(topics.REFERENCE_FORCE, ("x",), TIMEBASE)
    with pytest.raises(WireError, match="another rate"):
        receiver.decode(sender.encode(step, np.zeros(1)))
    later = sender.timebase.stamp_ns(1)
    with pytest.raises(WireError, match=f"point 1 is {later} ns after the stamp"):
        receiver.decode(sender.encode_points(0, np.zeros((2, 1))))


@pytest.mark.parametrize("nanoseconds", [1, 1_999_999, 2_000_000])
def test_a_first_point_after_the_stamp_is_refused(nanoseconds):
    codec = TrajectoryCodec(topics.REFERENCE_FORCE, ("x",), TIMEBASE)
    message = ros_message(codec, 3, np.zeros((1, 1, 1)))
    message.points[0].time_from_start.nanosec = nanoseconds
    with pytest.raises(WireError, match=f"point 0 is {nanoseconds} ns after the stamp"):
        codec.decode(serialization.serialize_message(message))


def test_a_message_without_points_is_refused():
    codec = TrajectoryCodec(topics.REFERENCE_FORCE, ("x",), TIMEBASE)
    with pytest.raises(WireError, match="at least one point"):
        codec.encode_points(0, np.zeros((0, 1)))
    with pytest.raises(WireError, match="no point"):
        codec.decode(serialization.serialize_message(ros_message(codec, 0, np.zeros((0, 1, 1)))))


def test_a_negative_stamp_is_refused():
    codec = TrajectoryCodec(topics.REFERENCE_FORCE, ("x",), TIMEBASE)
    with pytest.raises(WireError, match="-2000000 ns"):
        codec.decode(cdr(codec, -1, np.zeros((1, 1, 1))))


def test_every_truncation_is_refused():
    for topic in topics.LOOP_TOPICS:
        codec = TrajectoryCodec(topic, ("x", "y"), TIMEBASE)
        count = 1 if topic is topics.RIG_STATE else 2
        raw = codec.encode_points(9, np.ones((count, len(topic.quantities), 2)))
        for end in range(len(raw)):
            with pytest.raises(WireError):
                codec.decode(raw[:end])


def test_what_a_failed_sensor_shows_passes_both_ways():
    codec = TrajectoryCodec(topics.MEASURED, ("x", "y"), TIMEBASE)
    state = np.arange(8.0).reshape(4, 2)
    state[0, 1], state[3, 0] = np.nan, -np.inf
    raw = codec.encode(3, state)
    for each in (raw, cdr(codec, 3, state[np.newaxis], frame_id="slow way")):
        step, values = codec.decode(each)
        assert step == 3
        np.testing.assert_array_equal(values[0], state)
    batch = decode_batch(codec, np.frombuffer(raw, np.uint8)[np.newaxis])
    np.testing.assert_array_equal(batch.values[0], state)
