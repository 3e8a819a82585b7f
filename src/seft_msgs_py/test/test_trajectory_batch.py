import struct
from itertools import groupby

import numpy as np
from damaged_messages import damaged
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.topics import LOOP_TOPICS, RIG_STATE, TARGET, Timebase
from seft_msgs_py.wire.trajectory import TrajectoryCodec, decode_batch

TIMEBASE = Timebase.from_rate(500.0)
NAMES = ("x", "größe", "an axis of a longer name", "y3")
FINITE = st.floats(allow_nan=False, allow_infinity=False)


@st.composite
def batches(draw):
    """A codec and messages: of it, of other axes, topics and rates, and corrupted ones."""
    topic = draw(st.sampled_from((*LOOP_TOPICS, TARGET)))
    axes = NAMES[: draw(st.integers(1, len(NAMES)))]
    timebase = draw(st.sampled_from([TIMEBASE, Timebase.from_rate(1200.0)]))
    codec = TrajectoryCodec(topic, axes, timebase)
    others = [
        TrajectoryCodec(topic, axes[::-1], timebase),
        TrajectoryCodec(draw(st.sampled_from((*LOOP_TOPICS, TARGET))), axes, timebase),
        TrajectoryCodec(topic, axes, Timebase.from_rate(800.0)),
    ]
    raws = []
    for _ in range(draw(st.integers(0, 12))):
        sender = draw(st.sampled_from([codec, codec, codec, *others]))
        points = 1 if sender.topic is RIG_STATE else draw(st.sampled_from([1, 1, 3]))
        shape = (points, len(sender.topic.quantities), len(axes))
        values = draw(arrays(np.float64, shape, elements=FINITE))
        raw = sender.encode_points(draw(st.integers(0, 10**9)), values)
        match draw(st.sampled_from(["good", "good", "good", "damaged", "nan"])):
            case "damaged":
                raw = damaged(draw(st.data()), raw)
            case "nan":
                at = draw(st.sampled_from(range(4, len(raw) - 7, 8)))
                raw = raw[:at] + np.float64(np.nan).tobytes() + raw[at + 8 :]
        raws.append(raw)
    return codec, raws


def decode_all(codec, raws):
    """Decode messages of whatever length, as the runs of equal length that they are."""
    steps, values, messages, done, refused = [], [], [], 0, 0
    for length, run in groupby(raws, len):
        run = list(run)
        rows = np.frombuffer(b"".join(run), np.uint8).reshape(len(run), length)
        batch = decode_batch(codec, rows)
        assert batch.values.shape[1:] == (len(codec.topic.quantities), len(codec.axes))
        assert (batch.steps.dtype, batch.values.dtype) == (np.int64, np.float64)
        steps += batch.steps.tolist()
        values.append(batch.values.tobytes())
        messages += (batch.messages + done).tolist()
        done += len(run)
        refused += batch.refused
    return steps, b"".join(values), messages, refused


def decode_each(codec, raws):
    """What a batch must give: each message by itself."""
    steps, values, messages, refused = [], [], [], 0
    for index, raw in enumerate(raws):
        try:
            step, points = codec.decode(raw)
        except WireError:
            refused += 1
        else:
            steps += range(step, step + len(points))
            values.append(points.tobytes())
            messages += [index] * len(points)
    return steps, b"".join(values), messages, refused


def assert_as_each(codec, raws):
    assert decode_all(codec, raws) == decode_each(codec, raws)


@given(batches())
def test_a_batch_gives_what_its_messages_give_one_by_one(batch):
    assert_as_each(*batch)


def test_stamps_off_the_grid_and_before_the_start_are_refused():
    codec = TrajectoryCodec(RIG_STATE, ("x",), TIMEBASE)
    raws = [bytearray(codec.encode(step, np.zeros((6, 1)))) for step in range(6)]
    struct.pack_into("<iI", raws[1], 4, 0, 2_000_001)
    struct.pack_into("<iI", raws[2], 4, -1, 0)
    struct.pack_into("<iI", raws[3], 4, -1, 1_000_000_000)  # nanoseconds that make up for it
    raws = [bytes(raw) for raw in raws]
    assert_as_each(codec, raws)
    steps, _, _, refused = decode_all(codec, raws)
    assert (steps, refused) == ([0, 0, 4, 5], 2)


def test_no_message_is_an_empty_batch():
    codec = TrajectoryCodec(RIG_STATE, ("x", "y"), TIMEBASE)
    empty = decode_batch(codec, np.empty((0, 100), np.uint8))
    assert (len(empty.steps), empty.values.shape, empty.refused) == (0, (0, 6, 2), 0)
    assert_as_each(codec, [b"", b"", b"\x00\x01\x00\x00"])


def test_most_messages_never_meet_the_codec(monkeypatch):
    codec = TrajectoryCodec(RIG_STATE, ("x",), TIMEBASE)
    raws = [codec.encode(step, np.zeros((6, 1))) for step in range(50)]
    raws[20] = raws[20][:-8] + b"\x00" * 7 + b"\x01"  # a point is not at its time
    single = []
    monkeypatch.setattr(codec, "decode", lambda raw: single.append(raw) or (0, np.zeros((1, 6, 1))))
    decode_all(codec, raws)
    assert single == [raws[20]]
