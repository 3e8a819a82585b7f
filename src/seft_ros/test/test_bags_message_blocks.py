import struct

import pytest
from bags_at_hand import write_stock_bag
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import CompressionMode, Reader
from seft_msgs_py.wire.messages import encode_string
from seft_msgs_py.wire.topics import STRING
from seft_ros.bags import mcap_file
from seft_ros.bags.bag_files import Bag
from seft_ros.bags.message_blocks import records_of

TOPICS = ("/a", "/b", "/c")
MESSAGES = st.lists(
    st.tuples(st.sampled_from(TOPICS), st.integers(1, 12), st.booleans()), min_size=1, max_size=40
)


def write(path, messages, mode=CompressionMode.NONE, storage="mcap"):
    """A bag of (topic, log time, whether a chunk ends here); lengths differ now and then."""
    messages = [
        (topic, STRING, time, encode_string("x" * (number // 5) + f"{number:2d}"))
        for number, (topic, time, _) in enumerate(messages)
    ]
    ends = [number for number, (*_, end) in enumerate(messages) if end]
    return write_stock_bag(path, messages, storage, mode, ends)


def expected(path, topics):
    with Reader(path) as reader:
        wanted = [item for item in reader.connections if item.topic in topics]
        found = reader.messages(wanted) if wanted else ()  # of none, it gives all
        return [(item.topic, time, raw) for item, time, raw in found]


def found(path, topics):
    with Bag(path) as bag:
        assert bag.damage == []
        wanted = [source for source in bag.sources.values() if source.topic in topics]
        numbers = {(source.topic, source.type): k for k, source in enumerate(wanted)}
        return [
            (wanted[source].topic, time, raw)
            for block in bag.blocks(numbers)
            for source, time, raw in block.messages()
        ]


@settings(max_examples=60)
@given(MESSAGES, st.sets(st.sampled_from(TOPICS), min_size=1), st.sampled_from([1, 300, 1 << 20]))
def test_messages_come_as_they_were_written(tmp_path_factory, messages, topics, batch):
    path = write(tmp_path_factory.mktemp("bags") / "bag", messages)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mcap_file, "BATCH", batch)
        got = found(path, topics)
    wanted = [(topic, time) for topic, time, _ in messages if topic in topics]
    assert [(topic, time) for topic, time, _ in got] == wanted
    assert sorted(got) == sorted(expected(path, topics))


@pytest.mark.parametrize(
    ("storage", "mode"),
    [
        *(("mcap", mode) for mode in CompressionMode),
        *(("sqlite3", mode) for mode in CompressionMode if mode is not CompressionMode.STORAGE),
    ],
)
def test_bags_of_any_storage_and_single_files_are_read(tmp_path, storage, mode):
    messages = [(TOPICS[k % 3], k // 2, k % 7 == 0) for k in range(1, 60)]
    path = write(tmp_path / "bag", messages, mode, storage)
    assert len(found(path, TOPICS)) == 59
    assert sorted(found(path, TOPICS)) == sorted(expected(path, TOPICS))
    if mode is not CompressionMode.FILE:
        (file,) = (item for item in path.iterdir() if item.name != "metadata.yaml")
        if mode is CompressionMode.NONE:
            assert sorted(found(file, TOPICS)) == sorted(expected(file, TOPICS))


@st.composite
def chunks(draw):
    """Records of a chunk, and where its messages start."""
    data, starts, definitions = bytearray(), [], []
    for _ in range(draw(st.integers(0, 8))):
        opcode = draw(st.sampled_from([3, 4, 5, 5, 5, 9]))
        # what looks like records may stand in messages
        body = draw(st.sampled_from([b"", b"\x05", bytes(9), struct.pack("<BQ", 5, 22)]))
        body += bytes(draw(st.integers(22, 40)))
        if opcode == 5:
            starts.append(len(data))
        elif opcode < 5:
            definitions.append((opcode, body))
        data += struct.pack("<BQ", opcode, len(body)) + body
    return bytes(data), starts, definitions


@given(chunks())
def test_messages_and_definitions_are_found_between_other_records(chunk):
    raw, starts, definitions = chunk
    block, others = records_of(raw)
    assert (block.places["start"] - 31).tolist() == starts
    lengths = [struct.unpack_from("<Q", raw, start + 1)[0] - 22 for start in starts]
    assert block.places["length"].tolist() == lengths
    assert list(others) == definitions


CUT_OFF = [(30, cut) for cut in (1, 8, 9, 20, 38)]
TOO_LONG = [(length, 0) for length in (0, 21, 31, 1 << 62, 1 << 63, (1 << 64) - 1)]


@pytest.mark.parametrize(("length", "cut"), CUT_OFF + TOO_LONG)
def test_a_chunk_that_is_cut_off_or_has_an_impossible_record_is_damage(length, cut):
    record = struct.pack("<BQ", 5, length) + bytes(30)
    with pytest.raises(ValueError, match="do not fit"):
        records_of(record[: len(record) - cut])
