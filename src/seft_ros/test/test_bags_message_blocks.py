import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.rosbag2.errors import ReaderError
from rosbags.typesys import Stores, get_typestore
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.messages import encode_string
from seft_msgs_py.wire.topics import STRING
from seft_ros.bags import message_blocks
from seft_ros.bags.bag_files import open_bag
from seft_ros.bags.message_blocks import message_places, read_blocks

TOPICS = ("/a", "/b", "/c")
MESSAGES = st.lists(
    st.tuples(st.sampled_from(TOPICS), st.integers(1, 12), st.booleans()),
    min_size=1,
    max_size=40,
)


def write(path, messages, mode=CompressionMode.NONE, storage=StoragePlugin.MCAP):
    """A bag of (topic, log time, whether a chunk ends here)."""
    store = get_typestore(Stores.ROS2_JAZZY)
    writer = Writer(path, version=9, storage_plugin=storage)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        known = {name: writer.add_connection(name, STRING, typestore=store) for name in TOPICS}
        for number, (topic, time, ends) in enumerate(messages):
            # lengths differ now and then
            writer.write(known[topic], time, encode_string("x" * (number // 5) + f"{number:2d}"))
            if ends and storage is StoragePlugin.MCAP:
                writer.storage.close_chunk()
    return path


def expected(path, topics):
    with Reader(path) as reader:
        wanted = [item for item in reader.connections if item.topic in topics]
        return [(item.topic, time, raw) for item, time, raw in reader.messages(wanted)]


def found(path, topics):
    reader = open_bag(path)
    wanted = [item for item in reader.connections if item.topic in topics]
    numbers = {(item.topic, item.msgtype): k for k, item in enumerate(wanted)}
    try:
        return [
            (wanted[source].topic, time, raw)
            for block in read_blocks(reader, numbers, path)
            for source, time, raw in block.messages()
        ]
    finally:
        reader.close()


def without_index(path):
    """Let the index records behind all chunks say something else."""
    for file in path.glob("*.mcap"):
        raw = bytearray(file.read_bytes())
        with Reader(path) as reader:
            for chunk in reader.storage.storages[0].chunks:
                at = chunk.chunk_start_offset + chunk.chunk_length
                raw[at : at + chunk.message_index_length] = bytes(chunk.message_index_length)
        file.write_bytes(raw)
    return path


@settings(max_examples=60)
@given(
    MESSAGES,
    st.sets(st.sampled_from(TOPICS), min_size=1),
    st.sampled_from([1, 300, 1 << 20]),
    st.booleans(),
)
def test_messages_come_as_rosbags_gives_them(tmp_path_factory, messages, topics, batch, indexed):
    path = write(tmp_path_factory.mktemp("bags") / "bag", messages)
    if not indexed:
        without_index(path)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(message_blocks, "BATCH", batch)
        assert found(path, topics) == expected(path, topics)


@pytest.mark.parametrize("storage", list(StoragePlugin))
@pytest.mark.parametrize("mode", list(CompressionMode))
def test_bags_of_any_storage_and_single_files_are_read(tmp_path, storage, mode):
    if storage is StoragePlugin.SQLITE3 and mode is CompressionMode.STORAGE:
        pytest.skip("there is no such bag")
    messages = [(TOPICS[k % 3], k // 2, k % 7 == 0) for k in range(1, 60)]
    path = write(tmp_path / "bag", messages, mode, storage)
    assert len(found(path, TOPICS)) == 59
    assert found(path, TOPICS) == expected(path, TOPICS)
    if mode is not CompressionMode.FILE:
        (file,) = (item for item in path.iterdir() if item.name != "metadata.yaml")
        if mode is CompressionMode.NONE:
            assert found(file, TOPICS) == expected(file, TOPICS)


@pytest.mark.parametrize("at", [0.2, 0.5, 0.9])
def test_a_chunk_whose_records_do_not_fit_it_is_damage(tmp_path, at):
    path = write(tmp_path / "bag", [("/a", time, False) for time in range(1, 30)])
    (file,) = path.glob("*.mcap")
    raw = bytearray(file.read_bytes())
    records = [k for k in range(len(raw)) if raw[k : k + 9] == b"\x05" + struct.pack("<Q", 22 + 11)]
    struct.pack_into("<Q", raw, records[int(at * len(records))] + 1, 1 << 40)
    file.write_bytes(raw)
    with pytest.raises(InputError, match="damaged inside"):
        found(path, TOPICS)


@st.composite
def chunks(draw):
    """Records of a chunk, and where its messages start."""
    data, starts = bytearray(), []
    for _ in range(draw(st.integers(0, 8))):
        opcode = draw(st.sampled_from([3, 4, 5, 5, 5]))
        # what looks like records may stand in messages
        body = draw(st.sampled_from([b"", b"\x05", bytes(9), struct.pack("<BQ", 5, 22)]))
        body += bytes(draw(st.integers(22, 40)))
        if opcode == 5:
            starts.append(len(data))
        data += struct.pack("<BQ", opcode, len(body)) + body
    return bytes(data), starts


@settings(max_examples=300)
@given(chunks(), st.booleans())
def test_messages_are_found_between_other_records(chunk, wanted):
    raw, starts = chunk
    numbers = np.full(1 << 16, 7 if wanted else -1)
    places = message_places(np.frombuffer(raw, np.uint8), numbers)
    assert (places["start"] - 31).tolist() == (starts if wanted else [])
    assert set(places["source"].tolist()) <= {7}
    lengths = [struct.unpack_from("<Q", raw, start + 1)[0] - 22 for start in starts]
    assert places["length"].tolist() == (lengths if wanted else [])


@pytest.mark.parametrize("cut", [1, 8, 9, 20, 38])
def test_a_chunk_that_is_cut_off_is_damage(cut):
    record = struct.pack("<BQ", 5, 30) + bytes(30)
    with pytest.raises(ReaderError):
        message_places(np.frombuffer(record[:-cut], np.uint8), np.zeros(1 << 16, np.int64))


@pytest.mark.parametrize("length", [0, 21, 31, 1 << 62, 1 << 63, (1 << 64) - 1])
def test_a_record_of_an_impossible_length_is_damage(length):
    record = struct.pack("<BQ", 5, length) + bytes(30)
    with pytest.raises(ReaderError):
        message_places(np.frombuffer(record, np.uint8), np.zeros(1 << 16, np.int64))
