import errno
import signal
import sys

import numpy as np
import pytest
import yaml
from bags_at_hand import contents
from mcap.reader import make_reader
from recordings_at_hand import run_on_a_disk
from rosbags.interfaces import QosDurability, QosHistory, QosReliability
from rosbags.rosbag2 import Reader
from seft_msgs_py.errors import ExperimentError, InputError
from seft_msgs_py.wire.topics import DESCRIPTION, TOPICS, VALVE_COMMAND, Timebase
from seft_msgs_py.wire.trajectory import TrajectoryCodec
from seft_ros.bags import bag_writer
from seft_ros.bags.bag_files import Bag
from seft_ros.bags.bag_writer import BagWriter

CODEC = TrajectoryCodec(VALVE_COMMAND, ("x",), Timebase.from_rate(500.0))
START = 1_700_000_000_000_000_000

RECORDED_TOPICS = [topic for topic in TOPICS if topic.recorded]


def sample(step):
    return CODEC.encode(step, np.array([float(step)]))


def test_metadata_is_that_of_a_rosbag2_version_9_bag(tmp_path):
    bag = BagWriter(tmp_path / "bag")
    for step in range(5):
        bag.write(VALVE_COMMAND, sample(step), START + step)
    bag.close()
    (tree,) = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text()).values()
    assert tree["version"] == 9
    assert tree["storage_identifier"] == "mcap"
    assert tree["message_count"] == 5
    assert tree["starting_time"]["nanoseconds_since_epoch"] == START
    assert tree["duration"]["nanoseconds"] == 4


def test_topics_carry_standard_types_and_the_quality_of_service_they_are_sent_with(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        for topic in RECORDED_TOPICS:
            bag.write(topic, b"\x00\x01\x00\x00", START)
    with Reader(tmp_path / "bag") as reader:
        found = {connection.topic: connection for connection in reader.connections}
    assert set(found) == {"/" + topic.name for topic in RECORDED_TOPICS}
    for topic in RECORDED_TOPICS:
        connection = found["/" + topic.name]
        (qos,) = connection.ext.offered_qos_profiles
        package = connection.msgtype.split("/")[0]
        assert package in {"trajectory_msgs", "diagnostic_msgs", "std_msgs"}
        assert connection.msgtype == topic.type
        assert connection.msgdef.data
        assert qos.reliability is QosReliability.RELIABLE
        assert qos.history is QosHistory.KEEP_LAST
        assert qos.depth == topic.depth
        durability = QosDurability.TRANSIENT_LOCAL if topic.latched else QosDurability.VOLATILE
        assert qos.durability is durability


def test_the_mcap_package_reads_our_bags(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        for step in range(1000):
            bag.write(VALVE_COMMAND, sample(step), START + step)
            if step % 100 == 0:
                bag.flush()
    with (tmp_path / "bag" / "bag.mcap").open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        assert reader.get_summary().statistics.message_count == 1000
        found = [(c.topic, s.name, m.log_time, m.data) for s, c, m in reader.iter_messages()]
    name = "trajectory_msgs/msg/JointTrajectory"
    assert found == [("/valve_command", name, START + k, sample(k)) for k in range(1000)]


@pytest.mark.parametrize(
    ("place", "message"), [("bag", "exists already"), ("bag/file/bag", "no bag can be made there")]
)
def test_what_is_in_the_way_is_never_written_to(tmp_path, place, message):
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "file").write_text("")
    with pytest.raises(InputError, match=f"{message}.*--out"), BagWriter(tmp_path / place):
        pass
    assert [file.name for file in (tmp_path / "bag").iterdir()] == ["file"]


@pytest.mark.parametrize("reason", [KeyboardInterrupt, SystemExit, RuntimeError])
def test_the_bag_is_whole_whatever_ends_the_recording(tmp_path, reason):
    with pytest.raises(reason), BagWriter(tmp_path / "bag") as bag:
        bag.write(VALVE_COMMAND, sample(0), START)
        raise reason
    assert contents(tmp_path / "bag") == [("/valve_command", START, sample(0))]


def test_ctrl_c_within_a_write_waits_until_the_message_is_whole(tmp_path, monkeypatch):
    add = bag_writer.Writer.add_message

    def interrupted(*words, **more):
        signal.raise_signal(signal.SIGINT)
        add(*words, **more)
        signal.raise_signal(signal.SIGINT)

    # a process that a shell starts in the background ignores SIGINT
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    monkeypatch.setattr(bag_writer.Writer, "add_message", interrupted)
    try:
        bag = BagWriter(tmp_path / "bag")
        bag.write(VALVE_COMMAND, sample(0), START)
        with pytest.raises(KeyboardInterrupt):
            bag.flush()
    finally:
        signal.signal(signal.SIGINT, before)
    with Bag(tmp_path / "bag") as found:  # as if the process were killed now
        assert found.counts.total() == 1
    bag.close()


def test_writing_flushes_once_in_a_period_or_chunk_and_no_more(tmp_path, monkeypatch):
    now = 100.0
    monkeypatch.setattr(bag_writer.time, "monotonic", lambda: now)
    flushes, store = [], BagWriter._store
    monkeypatch.setattr(BagWriter, "_store", lambda bag: (store(bag), flushes.append(now))[0])
    with BagWriter(tmp_path / "bag") as bag:
        for step in range(1000):
            now += 0.001
            bag.write(VALVE_COMMAND, sample(step), step)
        period = 0.25
        assert flushes == pytest.approx(100 + period * np.arange(1, 5), abs=0.0011)
        now += 0.2
        bag.flush_if_due()
        assert len(flushes) == 4
        now += 0.1
        bag.flush_if_due()
        assert len(flushes) == 5
        bag.write(DESCRIPTION, bytes(bag_writer.CHUNK), 0)
        assert len(flushes) == 6
        monkeypatch.undo()


LITTLE_ROOM = """
import sys
sys.path[:0] = {paths}
from seft_msgs_py.wire.messages import encode_string
from seft_msgs_py.wire.topics import DESCRIPTION
from mcap.reader import make_reader
from seft_ros.bags import bag_writer
bag_writer.FLUSH_PERIOD = {period}
bag = bag_writer.BagWriter("bag")
for k in range(900):
    bag.write(DESCRIPTION, encode_string(f"{{k:10000}}"), k)
print(bag.trouble)
with (bag.save() / "bag.mcap").open("rb") as file:
    print(len([*make_reader(file, validate_crcs=True).iter_messages()]))
"""


@pytest.mark.parametrize("period", [0.0, 3600.0], ids=["seen in time", "seen too late"])
def test_what_a_full_disk_does_not_take_goes_into_the_room_that_was_reserved(tmp_path, period):
    script = LITTLE_ROOM.format(paths=[p for p in sys.path if p], period=period)
    message = run_on_a_disk("size=16m", tmp_path, "-c", script).splitlines()
    assert message == ["bag: No space left on device", "900"]


def refuse(*_):
    raise OSError(errno.ENOSPC, "No space left on device")


def test_what_a_full_disk_refused_is_written_when_there_is_room_again(tmp_path, monkeypatch):
    bag = BagWriter(tmp_path / "bag")
    with monkeypatch.context() as patch:
        patch.setattr(bag_writer.os, "pwrite", refuse)
        for step in range(3):
            bag.write(VALVE_COMMAND, sample(step), START + step)
            bag.flush()
        assert "No space left on device" in bag.trouble
        with pytest.raises(ExperimentError, match="No space left on device"):
            bag.close()
    bag.close()
    assert [raw for _, _, raw in contents(tmp_path / "bag")] == [sample(k) for k in range(3)]


def test_the_reason_for_leaving_is_not_hidden_by_a_full_disk(tmp_path, monkeypatch):
    monkeypatch.setattr(bag_writer.os, "pwrite", refuse)
    with pytest.raises(KeyboardInterrupt), BagWriter(tmp_path / "bag") as bag:
        bag.write(VALVE_COMMAND, sample(0), START)
        raise KeyboardInterrupt
