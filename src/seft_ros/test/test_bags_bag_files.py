import itertools
import os
import sqlite3
import struct

import bags_at_hand
import numpy as np
import pytest
import yaml
import zstandard
from bags_at_hand import write_stock_bag
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as PlainWriter
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.messages import encode_string
from seft_msgs_py.wire.topics import DESCRIPTION, VALVE_COMMAND, Timebase
from seft_msgs_py.wire.trajectory import TrajectoryCodec
from seft_ros.bags import bag_writer
from seft_ros.bags.bag_files import Bag, recover_bag
from seft_ros.bags.bag_writer import BagWriter

CODEC = TrajectoryCodec(VALVE_COMMAND, ("x",), Timebase.from_rate(500.0))
SAMPLES = [CODEC.encode(step, np.array([step + 0.1])) for step in range(12)]
TEXT = encode_string("what the test was")


ALL = [TEXT, *SAMPLES]


def contents(path):
    """What rosbags reads of a bag."""
    return [raw for *_, raw in bags_at_hand.contents(path)]


def messages(bag):
    numbers = {name: number for number, name in enumerate(bag.sources)}
    return [raw for block in bag.blocks(numbers) for *_, raw in block.messages()]


def readable(path):
    """What can be read of a damaged bag."""
    with Bag(path) as bag:
        assert bag.damage
        return messages(bag)


def write_bag(path):
    """A bag of one text and twelve samples, in three chunks."""
    with BagWriter(path) as bag:
        bag.write(DESCRIPTION, TEXT, 5)
        for step, raw in enumerate(SAMPLES):
            bag.write(VALVE_COMMAND, raw, 10 + step)
            if step in (3, 7):
                bag.flush()
    return path


def stock_bag(path, raws=ALL, storage="mcap"):
    """A bag of texts as another recorder writes it: without checksums."""
    messages = [("/text", DESCRIPTION.type, k, raw) for k, raw in enumerate(raws)]
    return write_stock_bag(path, messages, storage)


def plain_bag(file, raws=(TEXT,), backwards=False, **options):
    """A file of texts by mcap's own writer, perhaps with log times that go back."""
    with file.open("wb") as stream:
        writer = PlainWriter(stream, **options)
        writer.start(profile="ros2")
        schema = writer.register_schema(DESCRIPTION.type, "ros2msg", b"string data")
        channel = writer.register_channel("/text", "cdr", schema)
        for k, raw in enumerate(raws):
            writer.add_message(channel, 1000 - k if backwards else k, raw, k)
        writer.finish()


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Bytes of a whole mcap file, and where in it the chunk of each message ends."""
    path = write_bag(tmp_path_factory.mktemp("whole") / "bag") / "bag.mcap"
    data = path.read_bytes()
    ends, at = [], 8
    while at < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, at)
        at += 9 + length
        if opcode == 6:
            ends += [at] * sum(raw in data[at - length : at] for raw in ALL)
    assert len(ends) == len(ALL)
    return data, ends


def cut_bag(path, data):
    path.mkdir()
    (path / f"{path.name}.mcap").write_bytes(data)
    return path


def test_every_whole_chunk_is_found_wherever_the_file_ends(tmp_path, whole):
    data, ends = whole
    path = cut_bag(tmp_path / "bag", data)
    for size in {*range(0, len(data), 29), *ends, *(end - 1 for end in ends)}:
        os.truncate(path / "bag.mcap", 0)
        (path / "bag.mcap").write_bytes(data[:size])
        count = sum(end <= size for end in ends)
        if count:
            assert readable(path) == ALL[:count]
        else:
            with pytest.raises(InputError, match="nothing of the bag can be read"):
                Bag(path)


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


@pytest.mark.parametrize("storage", ["mcap", "sqlite3", None])
def test_an_intact_bag_is_left_untouched(tmp_path, storage):
    path = tmp_path / "bag"
    _ = stock_bag(path, storage=storage) if storage else write_bag(path)
    before = {file: (file.stat().st_mtime_ns, file.read_bytes()) for file in path.iterdir()}
    recovery = recover_bag(path)
    assert recovery.messages == 13
    assert "intact" in str(recovery)
    assert ("without checksums" in str(recovery)) == (storage is not None)
    assert recovery.original is None
    assert before == {f: (f.stat().st_mtime_ns, f.read_bytes()) for f in path.iterdir()}
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("size", [0, 5, 8, 30])
def test_a_file_without_a_whole_message_is_left_as_it_is(tmp_path, whole, size):
    path = cut_bag(tmp_path / "bag", whole[0][:size])
    with pytest.raises(InputError, match="nothing of the bag can be read"):
        recover_bag(path)
    assert (path / "bag.mcap").read_bytes() == whole[0][:size]
    assert list(tmp_path.iterdir()) == [path]


def test_what_is_no_bag_is_an_input_error(tmp_path):
    (tmp_path / "folder").mkdir()
    for name in ("file.txt", "text.mcap", "text.db3"):
        (tmp_path / name).write_text("no bag")
    for name, reason in ("none", "no such bag"), ("folder", "no bag"), ("file.txt", "not a bag"):
        with pytest.raises(InputError, match=reason):
            recover_bag(tmp_path / name)
    for name in ("text.mcap", "text.db3"):
        with pytest.raises(InputError, match=f"{name}: nothing of the bag can be read"):
            Bag(tmp_path / name)


def test_what_sqlite3_had_not_committed_is_taken_back_and_the_file_kept(tmp_path):
    path = stock_bag(tmp_path / "bag", storage="sqlite3")
    database = sqlite3.connect(path / "bag.db3", isolation_level=None)
    database.execute("PRAGMA cache_size = 1")  # so that changes go to the file uncommitted
    database.execute("BEGIN")
    database.execute("UPDATE messages SET data = zeroblob(4000)")
    raw, journal = ((path / f"bag.db3{end}").read_bytes() for end in ("", "-journal"))
    database.execute("ROLLBACK")
    database.close()
    (path / "bag.db3").write_bytes(raw)
    (path / "bag.db3-journal").write_bytes(journal)
    with Bag(path) as bag:
        assert messages(bag) == ALL
    assert (path / "bag.db3").read_bytes() == raw
    assert (path / "bag.db3-journal").read_bytes() == journal


@pytest.mark.parametrize("name", [b"offered_qos_profiles", b"serialization_format"])
def test_names_of_a_damaged_sqlite3_file_may_be_anything(tmp_path, name):
    path = stock_bag(tmp_path / "bag", storage="sqlite3")
    file = path / "bag.db3"
    raw = file.read_bytes()
    assert name in raw
    file.write_bytes(raw.replace(name, b"\xe4" + name[1:]))
    with pytest.raises(InputError, match="nothing of the bag can be read"):
        recover_bag(path)


@pytest.mark.parametrize("how", ["cut", "zeroed"])
def test_a_damaged_sqlite3_file_is_refused_with_what_mends_it(tmp_path, how):
    texts = [encode_string(f"{k:900}") for k in range(200)]
    path = stock_bag(tmp_path / "bag", texts, "sqlite3")
    if how == "cut":
        os.truncate(path / "bag.db3", 100_000)
    else:
        raw = bytearray((path / "bag.db3").read_bytes())
        raw[24 * 4096 : 26 * 4096] = bytes(2 * 4096)  # two pages; it has no checksums
        (path / "bag.db3").write_bytes(raw)
    with pytest.raises(InputError, match=r"database disk image is malformed; mend it by sqlite3"):
        recover_bag(path)


def test_a_single_file_is_recovered_in_its_place(tmp_path, whole):
    data, ends = whole
    file = tmp_path / "run_0.mcap"
    file.write_bytes(data[: ends[5]])
    recovery = recover_bag(file)
    assert recovery.original == tmp_path / "run_0.mcap.cut"
    assert contents(file) == ALL[: ends.count(ends[0]) + ends.count(ends[5])]
    assert {entry.name for entry in tmp_path.iterdir()} == {"run_0.mcap", "run_0.mcap.cut"}


def test_a_damaged_single_file_of_another_kind_becomes_an_mcap_file(tmp_path, whole):
    packed = zstandard.ZstdCompressor(level=-100).compress(whole[0] + os.urandom(1 << 18))
    (tmp_path / "x.mcap.zstd").write_bytes(packed[:-1000])
    recovery = recover_bag(tmp_path / "x.mcap.zstd")
    assert recovery.path == tmp_path / "x.mcap"
    assert contents(tmp_path / "x.mcap") == ALL
    assert recovery.original == tmp_path / "x.mcap.zstd.cut"


@pytest.mark.parametrize("lost", [None, "bag_10.mcap"])
def test_several_files_are_read_in_the_order_of_their_numbers(tmp_path, lost):
    path = tmp_path / "bag"
    path.mkdir()
    info = None
    for number in (9, 10, 11):
        part = write_bag(tmp_path / f"part_{number}")
        (part / f"{part.name}.mcap").rename(path / f"bag_{number}.mcap")
        tree = yaml.safe_load((part / "metadata.yaml").read_text())
        info = info or tree["rosbag2_bagfile_information"]
        info["relative_file_paths"] = [f"bag_{n}.mcap" for n in (9, 10, 11)]
    for topic in info["topics_with_message_count"]:
        topic["message_count"] *= 3
    (path / "metadata.yaml").write_text(yaml.safe_dump(tree | {next(iter(tree)): info}))
    if lost is None:
        with Bag(path) as bag:
            assert bag.damage == []
            assert messages(bag) == 3 * ALL
        return
    (path / lost).unlink()
    assert readable(path) == 2 * ALL
    assert recover_bag(path).damage == [
        f"the file {lost} is missing",
        "/experiment/description: 1 of 3 messages are missing",
        "/valve_command: 12 of 36 messages are missing",
    ]


@pytest.mark.parametrize("compression", list(CompressionType))
def test_of_compressed_chunks_the_whole_ones_are_kept(tmp_path, compression):
    rng = np.random.default_rng(0)
    texts = [encode_string(rng.bytes(1000).hex()) for _ in range(400)]
    (tmp_path / "bag").mkdir()
    file = tmp_path / "bag" / "bag.mcap"
    plain_bag(file, texts, compression=compression, chunk_size=10_000)
    os.truncate(file, file.stat().st_size // 2)
    recovery = recover_bag(tmp_path / "bag")
    assert 150 < recovery.messages < 400
    assert contents(tmp_path / "bag") == texts[: recovery.messages]


OTHERS = {
    "without chunks": {"use_chunking": False},
    "without a summary": {"use_summary_offsets": False, "use_statistics": False},
    "without an index": {"index_types": IndexType.NONE, "repeat_channels": False},
    "without anything": {"use_chunking": False, "index_types": IndexType.NONE}
    | dict.fromkeys(("repeat_schemas", "repeat_channels", "use_statistics"), False),
    "with checksums": {"enable_data_crcs": True, "compression": CompressionType.LZ4},
}


@pytest.mark.parametrize("cut", [False, True])
@pytest.mark.parametrize("other", list(OTHERS))
def test_mcap_of_other_writers_is_read_in_its_order_as_far_as_it_goes(tmp_path, other, cut):
    rng, file = np.random.default_rng(0), tmp_path / "bag.mcap"
    texts = [encode_string(rng.bytes(1000).hex()) for _ in range(40)]
    plain_bag(file, texts, backwards=True, chunk_size=10_000, **OTHERS[other])
    if cut:
        os.truncate(file, file.stat().st_size // 2)
    with Bag(file) as bag:
        found = messages(bag)
        assert (found == texts[: len(found)], len(found) == 40) == (True, not cut)
        assert len(found) > 10
        assert bool(bag.damage) == cut


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
    path = cut_bag(tmp_path / "bag", whole[0][:-100])
    (tmp_path / "bag.cut").mkdir()
    with pytest.raises(InputError, match=r"bag.cut is in the way.*move it elsewhere"):
        recover_bag(path)
    assert (path / "bag.mcap").read_bytes() == whole[0][:-100]


def test_a_recovery_that_was_killed_half_way_is_done_again(tmp_path, whole):
    path = cut_bag(tmp_path / "bag", whole[0][:-100])
    left = tmp_path / "bag.recovering" / "parts" / "bag"
    left.mkdir(parents=True)
    (left / "bag.mcap").write_bytes(b"half")
    recover_bag(path)
    assert contents(path)
    assert not (tmp_path / "bag.recovering").exists()


def test_a_disk_that_refuses_leaves_the_recording_as_it_was(tmp_path, whole, monkeypatch):
    path = cut_bag(tmp_path / "bag", whole[0][:-100])

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(bag_writer.os, "pwrite", full)
    with pytest.raises(InputError, match=r"No space.*it is as it was"):
        recover_bag(path)
    assert (path / "bag.mcap").read_bytes() == whole[0][:-100]
    assert list(tmp_path.iterdir()) == [path]


def bomb(size, declared=True):
    """A file that would unpack to far more than there is memory."""
    packer = zstandard.ZstdCompressor(write_content_size=declared)
    if declared:
        return packer.compress(bytes(size))
    stream = packer.compressobj()
    parts = [stream.compress(bytes(1 << 20)) for _ in range(size >> 20)]
    return b"".join((*parts, stream.flush()))


def chunk(unpacked, packed):
    body = struct.pack("<QQQII", 0, 0, unpacked, 1, 4) + b"zstd" + struct.pack("<Q", len(packed))
    return b"\x06" + struct.pack("<Q", len(body) + len(packed)) + body + packed


MAGIC = b"\x89MCAP0\r\n"
BOMBS = {
    "more than can be": ("x.mcap.zstd", lambda: bomb(1 << 27)),
    "undeclared": ("x.mcap.zstd", lambda: bomb(1 << 27, declared=False)),
    "a chunk of more than it declares": ("x.mcap", lambda: MAGIC + chunk(1000, bomb(1 << 27))),
    "a chunk that declares all memory": ("x.mcap", lambda: MAGIC + chunk(1 << 45, bomb(1 << 20))),
    "a record of all memory": ("x.mcap", lambda: MAGIC + struct.pack("<BQ", 12, 1 << 62)),
}


@pytest.mark.parametrize("kind", list(BOMBS))
def test_a_file_is_refused_before_it_takes_more_memory_than_it_has(tmp_path, kind):
    name, make = BOMBS[kind]
    (tmp_path / name).write_bytes(make())
    for use in (Bag, recover_bag):
        with pytest.raises(InputError, match="nothing of the bag can be read"):
            use(tmp_path / name)


NO_FILES = {
    "empty": lambda file: file.touch(),
    "fifo": os.mkfifo,
    "folder": lambda file: file.mkdir(),
    "dangling": lambda file: file.symlink_to("nowhere"),
    "endless": lambda file: file.symlink_to("/dev/zero"),
}


@pytest.mark.parametrize("storage", ["mcap", "db3"])
@pytest.mark.parametrize("kind", list(NO_FILES))
def test_what_is_no_file_of_a_bag_is_reported_in_one_line(tmp_path, storage, kind):
    file = tmp_path / "bag" / f"bag.{storage}"
    file.parent.mkdir()
    NO_FILES[kind](file)
    for use, path in itertools.product((Bag, recover_bag), (file.parent, file)):
        with pytest.raises(InputError):
            use(path)
