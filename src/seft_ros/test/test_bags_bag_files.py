import os
import shutil
import sqlite3

import numpy as np
import pytest
import yaml
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType
from mcap.writer import Writer as PlainWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.messages import encode_string
from seft_msgs_py.wire.topics import DESCRIPTION, VALVE_COMMAND, Timebase
from seft_msgs_py.wire.trajectory import TrajectoryCodec
from seft_ros.bags import bag_files
from seft_ros.bags.bag_files import open_bag, recover_bag
from seft_ros.bags.bag_storage import mcap_messages
from seft_ros.bags.bag_writer import BagWriter

CODEC = TrajectoryCodec(VALVE_COMMAND, ("x",), Timebase.from_rate(500.0))
SAMPLES = [CODEC.encode(step, np.array([step + 0.1])) for step in range(12)]
TEXT = encode_string("what the test was")


def contents(path):
    with Reader(path) as reader:
        return [bytes(raw) for _, _, raw in reader.messages()]


def write_bag(path, storage="mcap"):
    """A bag of one text and twelve samples, in three chunks."""
    with BagWriter(path, storage) as bag:
        bag.write(DESCRIPTION, TEXT, 5)
        for step, raw in enumerate(SAMPLES):
            bag.write(VALVE_COMMAND, raw, 10 + step)
            if step in (3, 7):
                bag.flush()
    return path


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Bytes of a whole mcap file, and where in it each message ends."""
    path = write_bag(tmp_path_factory.mktemp("whole") / "bag") / "bag.mcap"
    data = path.read_bytes()
    return data, [data.index(raw) + len(raw) for raw in (TEXT, *SAMPLES)]


def cut_bag(path, data):
    path.mkdir()
    (path / f"{path.name}.mcap").write_bytes(data)
    return path


def test_every_whole_message_is_found_wherever_the_file_ends(tmp_path, whole):
    data, ends = whole
    file = tmp_path / "cut.mcap"
    for size in {*range(0, len(data), 5), *ends, *(end - 1 for end in ends)}:
        file.write_bytes(data[:size])
        found = [raw for _, _, raw in mcap_messages(file)]
        assert found == [TEXT, *SAMPLES][: sum(end <= size for end in ends)]


@given(size=st.integers(0, 5000), garbage=st.binary(max_size=60))
def test_garbage_after_the_cut_never_stops_the_recovery(tmp_path_factory, whole, size, garbage):
    data, ends = whole
    file = tmp_path_factory.mktemp("garbage") / "cut.mcap"
    file.write_bytes(data[:size] + garbage)
    found = [raw for _, _, raw in mcap_messages(file)]
    count = sum(end <= size for end in ends)
    assert found[:count] == [TEXT, *SAMPLES][:count]


def boundaries(data, tmp_path):
    """Ends of the records of an mcap file, by kind."""
    file = tmp_path / "whole.mcap"
    file.write_bytes(data)
    found = {}
    with file.open("rb") as stream:
        for record in StreamReader(stream, emit_chunks=True).records:
            found.setdefault(type(record).__name__, stream.tell())
    return found


def test_a_bag_that_was_cut_off_is_whole_again(tmp_path, whole):
    data, ends = whole
    at = boundaries(data, tmp_path)
    sizes = {
        "in the first chunk's second message": ends[1] - 1,
        "behind a message": ends[2],
        "behind the first chunk": at["Chunk"],
        "in the first chunk's index": at["MessageIndex"] - 3,
        "in a later chunk's header": data.index(b"\x06", ends[4]) + 20,
        "before the metadata": ends[-1] + 1,
        "in the metadata": at["Metadata"] - 10,
        "in the summary": at["ChunkIndex"] - 1,
        "before the footer": at["Footer"] - 29,
        "without the end magic": len(data) - 8,
        "one byte short": len(data) - 1,
        "whole but for the metadata file": len(data),
    }
    for number, (where, size) in enumerate(sizes.items()):
        path = cut_bag(tmp_path / f"bag{number}", data[:size])
        recovery = recover_bag(path)
        expected = [TEXT, *SAMPLES][: sum(end <= size for end in ends)]
        assert contents(path) == expected, where
        assert not recovery.intact
        assert recovery.messages == len(expected)
        assert recovery.original == path.with_name(path.name + ".cut")
        assert (recovery.original / f"{path.name}.mcap").read_bytes() == data[:size]
        assert {entry.name for entry in path.iterdir()} == {f"{path.name}.mcap", "metadata.yaml"}
        assert not path.with_name(path.name + ".recovering").exists()


def test_a_recovered_bag_keeps_types_and_quality_of_service(tmp_path, whole):
    data, _ = whole
    write_bag(tmp_path / "original")
    cut_bag(tmp_path / "bag", data[:-100])
    recover_bag(tmp_path / "bag")
    trees = []
    for name in ("original", "bag"):
        (tree,) = yaml.safe_load((tmp_path / name / "metadata.yaml").read_text()).values()
        trees.append(tree)
    assert trees[1]["topics_with_message_count"] == trees[0]["topics_with_message_count"]
    assert trees[1]["starting_time"] == trees[0]["starting_time"]
    assert trees[1]["duration"] == trees[0]["duration"]


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_an_intact_bag_is_left_untouched(tmp_path, storage):
    path = write_bag(tmp_path / "bag", storage)
    before = {file: (file.stat().st_mtime_ns, file.read_bytes()) for file in path.iterdir()}
    recovery = recover_bag(path)
    assert recovery.intact
    assert recovery.messages == 13
    assert "intact" in str(recovery)
    assert recovery.original is None
    assert before == {f: (f.stat().st_mtime_ns, f.read_bytes()) for f in path.iterdir()}
    assert list(tmp_path.iterdir()) == [path]


def test_a_recovered_bag_is_intact(tmp_path, whole):
    path = cut_bag(tmp_path / "bag", whole[0][:2000])
    assert "whole again" in str(recover_bag(path))
    assert recover_bag(path).intact


@pytest.mark.parametrize("size", [0, 5, 8, 30])
def test_a_file_without_a_whole_message_is_left_as_it_is(tmp_path, whole, size):
    path = cut_bag(tmp_path / "bag", whole[0][:size])
    with pytest.raises(InputError, match="nothing to recover"):
        recover_bag(path)
    assert (path / "bag.mcap").read_bytes() == whole[0][:size]
    assert list(tmp_path.iterdir()) == [path]


def test_what_is_no_bag_is_an_input_error(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "file.txt").write_text("no bag")
    for name, reason in [("none", "no such bag"), ("folder", "no bag"), ("file.txt", "not a bag")]:
        with pytest.raises(InputError, match=reason):
            recover_bag(tmp_path / name)


def test_a_sqlite3_bag_without_metadata_is_whole_again(tmp_path):
    path = write_bag(tmp_path / "bag", "sqlite3")
    (path / "metadata.yaml").unlink()
    recovery = recover_bag(path)
    assert recovery.messages == 13
    assert contents(path) == [TEXT, *SAMPLES]
    assert (tmp_path / "bag.cut" / "bag.db3").exists()


def test_what_sqlite3_had_not_committed_is_rolled_back_and_the_original_kept(tmp_path):
    path = write_bag(tmp_path / "bag", "sqlite3")
    (path / "metadata.yaml").unlink()
    database = sqlite3.connect(path / "bag.db3", isolation_level=None)
    database.execute("PRAGMA cache_size = 1")  # so that changes go to the file uncommitted
    database.execute("BEGIN")
    database.execute("UPDATE messages SET data = zeroblob(4000)")
    shutil.copytree(path, tmp_path / "killed")
    database.execute("ROLLBACK")
    database.close()
    (tmp_path / "killed" / "bag.db3").rename(tmp_path / "killed" / "killed.db3")
    (tmp_path / "killed" / "bag.db3-journal").rename(tmp_path / "killed" / "killed.db3-journal")
    before = (tmp_path / "killed" / "killed.db3").read_bytes()
    recover_bag(tmp_path / "killed")
    assert contents(tmp_path / "killed") == [TEXT, *SAMPLES]
    assert (tmp_path / "killed.cut" / "killed.db3").read_bytes() == before
    assert (tmp_path / "killed.cut" / "killed.db3-journal").exists()


@pytest.mark.parametrize("name", [b"offered_qos_profiles", b"serialization_format"])
def test_names_of_a_damaged_sqlite3_file_may_be_anything(tmp_path, name):
    path = write_bag(tmp_path / "bag", "sqlite3")
    file = path / "bag.db3"
    raw = file.read_bytes()
    assert name in raw
    file.write_bytes(raw.replace(name, b"\xe4" + name[1:]))
    with pytest.raises(InputError, match="no whole message"):
        recover_bag(path)


def test_of_a_damaged_sqlite3_file_the_reachable_messages_are_kept(tmp_path):
    path = tmp_path / "bag"
    texts = [encode_string(f"{k:900}") for k in range(200)]
    with BagWriter(path, "sqlite3") as bag:
        for k, raw in enumerate(texts):
            bag.write(DESCRIPTION, raw, k)
    (path / "metadata.yaml").unlink()
    os.truncate(path / "bag.db3", 100_000)
    recovery = recover_bag(path)
    assert 50 < recovery.messages < 200
    assert contents(path) == texts[: recovery.messages]


def test_a_single_file_is_recovered_in_its_place(tmp_path, whole):
    data, ends = whole
    file = tmp_path / "run_0.mcap"
    file.write_bytes(data[: ends[5]])
    recovery = recover_bag(file)
    assert recovery.original == tmp_path / "run_0.mcap.cut"
    assert contents(file) == [TEXT, *SAMPLES][:6]
    assert {entry.name for entry in tmp_path.iterdir()} == {"run_0.mcap", "run_0.mcap.cut"}


def test_several_files_become_one_in_the_order_of_their_numbers(tmp_path):
    path = tmp_path / "bag"
    path.mkdir()
    for number in (9, 10, 11):
        part = tmp_path / f"part_{number}"
        with BagWriter(part) as bag:
            bag.write(DESCRIPTION, encode_string(str(number)), number)
        shutil.move(part / f"{part.name}.mcap", path / f"bag_{number}.mcap")
    recovery = recover_bag(path)
    assert contents(path) == [encode_string(str(number)) for number in (9, 10, 11)]
    assert recovery.messages == 3


@pytest.mark.parametrize("mode", [m for m in CompressionMode if m is not CompressionMode.NONE])
def test_compressed_recordings_are_recovered(tmp_path, mode):
    writer = Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    store = get_typestore(Stores.ROS2_JAZZY)
    with writer:
        connection = writer.add_connection("/text", DESCRIPTION.type, typestore=store)
        for k, raw in enumerate([TEXT, *SAMPLES]):
            writer.write(connection, k, raw)
    (tmp_path / "bag" / "metadata.yaml").unlink()
    recover_bag(tmp_path / "bag")
    assert contents(tmp_path / "bag") == [TEXT, *SAMPLES]


@pytest.mark.parametrize("compression", list(CompressionType))
def test_of_a_compressed_chunk_that_is_cut_off_the_readable_messages_are_kept(
    tmp_path, compression
):
    rng = np.random.default_rng(0)
    messages = [encode_string(rng.bytes(1000).hex()) for _ in range(400)]
    (tmp_path / "bag").mkdir()
    file = tmp_path / "bag" / "bag.mcap"
    with file.open("wb") as stream:
        writer = PlainWriter(stream, compression=compression, chunk_size=10**7)
        writer.start(profile="ros2")
        schema = writer.register_schema(DESCRIPTION.type, "ros2msg", b"string data")
        channel = writer.register_channel("/text", "cdr", schema)
        for k, raw in enumerate(messages):
            writer.add_message(channel, k, raw, k)
        writer.finish()
    os.truncate(file, file.stat().st_size // 2)
    recovery = recover_bag(tmp_path / "bag")
    assert 100 < recovery.messages < 400
    assert contents(tmp_path / "bag") == messages[: recovery.messages]


def test_messages_of_foreign_types_are_kept_with_their_definition(tmp_path):
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg("float64 volts", "lab_msgs/msg/Bridge"))
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/bridge", "lab_msgs/msg/Bridge", typestore=store)
        writer.write(connection, 3, b"\x00\x01\x00\x00" + bytes(8))
    (tmp_path / "bag" / "metadata.yaml").unlink()
    recover_bag(tmp_path / "bag")
    with Reader(tmp_path / "bag") as reader:
        (found,) = reader.connections
        assert "float64 volts" in found.msgdef.data
        assert found.digest == store.hash_rihs01("lab_msgs/msg/Bridge")


def test_an_earlier_original_is_never_overwritten(tmp_path, whole):
    path = cut_bag(tmp_path / "bag", whole[0][:2000])
    (tmp_path / "bag.cut").mkdir()
    with pytest.raises(InputError, match=r"bag.cut is in the way.*move it elsewhere"):
        recover_bag(path)
    assert (path / "bag.mcap").read_bytes() == whole[0][:2000]


def test_a_recovery_that_was_killed_half_way_is_done_again(tmp_path, whole):
    path = cut_bag(tmp_path / "bag", whole[0][:2000])
    left = tmp_path / "bag.recovering" / "parts" / "bag"
    left.mkdir(parents=True)
    (left / "bag.mcap").write_bytes(b"half")
    recover_bag(path)
    assert contents(path)
    assert not (tmp_path / "bag.recovering").exists()


def test_a_recovery_that_was_killed_between_the_two_renames_is_finished(
    tmp_path, whole, monkeypatch
):
    path = cut_bag(tmp_path / "bag", whole[0][:2000])
    recover_bag(path)
    expected = contents(path)
    (tmp_path / "bag.recovering").mkdir()
    path.rename(tmp_path / "bag.recovering" / "bag")
    recovery = recover_bag(path)
    assert contents(path) == expected
    assert recovery.original == tmp_path / "bag.cut"
    assert not (tmp_path / "bag.recovering").exists()


@pytest.mark.parametrize(
    "error",
    [
        OSError(28, "No space left on device"),
        sqlite3.OperationalError("database or disk is full"),
    ],
)
def test_a_disk_that_refuses_leaves_the_recording_as_it_was(tmp_path, whole, monkeypatch, error):
    path = cut_bag(tmp_path / "bag", whole[0][:2000])

    def full(*_, **__):
        raise error

    monkeypatch.setattr(bag_files, "Writer", full)
    with pytest.raises(InputError, match=r"(No space|disk is full).*it is as it was"):
        recover_bag(path)
    assert (path / "bag.mcap").read_bytes() == whole[0][:2000]
    assert list(tmp_path.iterdir()) == [path]


def test_opening_a_cut_off_bag_says_how_to_get_it_back(tmp_path, whole):
    path = cut_bag(tmp_path / "bag", whole[0][:2000])
    (path / "metadata.yaml").write_text("")
    for bag in (path, path / "bag.mcap"):
        with pytest.raises(InputError, match=f"cut off.*seft recover {bag}"):
            open_bag(bag)


def test_a_packed_file_that_is_cut_off_is_told_not_lost(tmp_path, whole):
    packed = zstandard.ZstdCompressor().compress(whole[0])
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "bag_0.mcap.zstd").write_bytes(packed[: len(packed) // 2])
    try:
        recover_bag(tmp_path / "bag")
    except InputError:
        assert (tmp_path / "bag" / "bag_0.mcap.zstd").exists()
    else:
        assert (tmp_path / "bag.cut" / "bag_0.mcap.zstd").exists()
