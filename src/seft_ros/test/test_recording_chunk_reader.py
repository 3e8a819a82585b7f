import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from seft_msgs_py.messages import encode_string
from seft_msgs_py.topics import STRING
from seft_ros.recording.chunk_reader import BagReader

TOPICS = ("/a", "/b", "/c")


def write(path, messages, mode=CompressionMode.NONE):
    """A bag of (topic, log time, whether a chunk ends here)."""
    store = get_typestore(Stores.ROS2_JAZZY)
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        known = {name: writer.add_connection(name, STRING, typestore=store) for name in TOPICS}
        for number, (topic, time, ends) in enumerate(messages):
            writer.write(known[topic], time, encode_string(f"message {number}"))
            if ends:
                writer.storage.close_chunk()
    return path


def read(kind, path, topics):
    with kind(path) as reader:
        wanted = [item for item in reader.connections if item.topic in topics]
        return [(item.topic, time, raw) for item, time, raw in reader.messages(wanted)]


@settings(deadline=None, max_examples=60)
@given(
    st.lists(
        st.tuples(st.sampled_from(TOPICS), st.integers(1, 12), st.booleans()),
        min_size=1,
        max_size=40,
    ),
    st.sets(st.sampled_from(TOPICS), min_size=1),
)
def test_messages_come_as_rosbags_gives_them(tmp_path_factory, messages, topics):
    path = write(tmp_path_factory.mktemp("bags") / "bag", messages)
    assert read(BagReader, path, topics) == read(Reader, path, topics)


@pytest.mark.parametrize("mode", list(CompressionMode))
def test_compressed_bags_and_single_files_are_read(tmp_path, mode):
    messages = [(TOPICS[k % 3], k // 2, k % 7 == 0) for k in range(1, 60)]
    path = write(tmp_path / "bag", messages, mode)
    assert len(read(BagReader, path, TOPICS)) == 59
    assert read(BagReader, path, TOPICS) == read(Reader, path, TOPICS)
    if mode is not CompressionMode.FILE:
        file = path / "bag.mcap"
        assert read(BagReader, file, TOPICS) == read(Reader, file, TOPICS)


def test_a_part_of_a_bag_is_read(tmp_path):
    path = write(tmp_path / "bag", [("/a", time, time % 3 == 0) for time in range(1, 10)])
    with BagReader(path) as reader:
        found = [time for _, time, _ in reader.messages(reader.connections, 3, 7)]
    assert found == [3, 4, 5, 6]
