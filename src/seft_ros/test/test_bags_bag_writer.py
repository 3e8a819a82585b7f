import errno
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import yaml
from bags_at_hand import contents
from mcap.reader import make_reader
from records_at_hand import run_on_a_disk
from rosbags.interfaces import QosDurability, QosHistory, QosReliability
from rosbags.rosbag2 import Reader
from seft_msgs_py.errors import ExperimentError, InputError
from seft_msgs_py.wire.messages import encode_string
from seft_msgs_py.wire.topics import (
    DESCRIPTION,
    EXPERIMENT_STATE,
    TOPICS,
    VALVE_COMMAND,
    Timebase,
)
from seft_msgs_py.wire.trajectory import TrajectoryCodec
from seft_ros.bags import bag_writer
from seft_ros.bags.bag_files import recover_bag
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


def test_an_existing_path_is_never_written_to(tmp_path):
    (tmp_path / "bag").mkdir()
    with (
        pytest.raises(InputError, match="bag exists already; name another folder with --out"),
        BagWriter(tmp_path / "bag"),
    ):
        pass
    assert list((tmp_path / "bag").iterdir()) == []


def test_a_folder_that_cannot_be_made_is_an_input_error(tmp_path):
    (tmp_path / "file").write_text("")
    with (
        pytest.raises(InputError, match=r"no bag can be made there .*--out"),
        BagWriter(tmp_path / "file" / "bag"),
    ):
        pass


@pytest.mark.parametrize("reason", [KeyboardInterrupt, SystemExit, RuntimeError])
def test_the_bag_is_whole_whatever_ends_the_recording(tmp_path, reason):
    with pytest.raises(reason), BagWriter(tmp_path / "bag") as bag:
        bag.write(VALVE_COMMAND, sample(0), START)
        raise reason
    assert contents(tmp_path / "bag") == [("/valve_command", START, sample(0))]


class InterruptAt:
    """Send this process SIGINT at the n-th line that runs inside the bag's code."""

    def __init__(self, line):
        self.left = line

    def __enter__(self):
        # a process that a shell starts in the background ignores SIGINT
        self.before = signal.signal(signal.SIGINT, signal.default_int_handler)
        sys.settrace(self.trace)

    def __exit__(self, *_):
        sys.settrace(None)
        signal.signal(signal.SIGINT, self.before)

    def trace(self, frame, event, _):
        name = frame.f_code.co_filename
        if not any(part in name for part in ("/mcap/", "/bags/bag_")):
            return None
        if event == "line":
            self.left -= 1
            if self.left == 0:
                sys.settrace(None)
                signal.raise_signal(signal.SIGINT)
        return self.trace


def test_ctrl_c_anywhere_in_a_write_leaves_no_half_message(tmp_path, monkeypatch):
    monkeypatch.setattr(bag_writer, "FLUSH_PERIOD", 0.0)  # so that each write flushes as well
    text = encode_string("first on its topic")
    interrupted = 0
    for count, line in enumerate(range(1, 1000, 7)):  # every line would take 20 s
        path = tmp_path / f"bag{line}"
        with BagWriter(path) as bag:
            bag.write(VALVE_COMMAND, sample(0), START)
            try:
                with InterruptAt(line):
                    bag.write(DESCRIPTION, text, START + 1)
            except KeyboardInterrupt:
                interrupted += 1
            bag.write(EXPERIMENT_STATE, b"\x00\x01\x00\x00", START + 2)
            bag.write(DESCRIPTION, text, START + 3)
        found = contents(path)
        assert found[0] == ("/valve_command", START, sample(0))
        assert found[-1] == ("/experiment/description", START + 3, text)
        if len(found) == 4:
            assert found[1] == ("/experiment/description", START + 1, text)
        else:
            assert len(found) == 3
        if interrupted == count:  # the write was over before that line
            break
    assert interrupted > 10


KILLED = """
import sys, time
from pathlib import Path
sys.path[:0] = {paths}
from seft_msgs_py.wire.messages import encode_string
from seft_msgs_py.wire.topics import DESCRIPTION
from seft_ros.bags import bag_writer
bag_writer.FLUSH_PERIOD = {period}
bag = bag_writer.BagWriter({path!r})
for k in range(3000):
    bag.write(DESCRIPTION, encode_string(str(k)), k)
{flush}
print("written", flush=True)
while True:
    bag.write(DESCRIPTION, encode_string("unflushed"), 10**6)
    time.sleep(0.001)
"""


def killed_recorder(path, period, flush):
    paths = [p for p in sys.path if p]
    script = KILLED.format(paths=paths, path=str(path), period=period, flush=flush)
    child = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE)
    try:
        assert child.stdout.readline() == b"written\n"
        time.sleep(0.05)
    finally:
        child.send_signal(signal.SIGKILL)
        child.wait()
        child.stdout.close()


@pytest.mark.parametrize(
    ("period", "flush"), [(1e9, "bag.flush()"), (0.05, "time.sleep(0.06); bag.flush_if_due()")]
)
def test_a_killed_writer_loses_nothing_that_was_flushed_or_due_to_be(tmp_path, period, flush):
    killed_recorder(tmp_path / "bag", period, flush)
    assert not (tmp_path / "bag" / "metadata.yaml").exists()
    recovery = recover_bag(tmp_path / "bag")
    found = [raw for _, _, raw in contents(tmp_path / "bag")]
    assert found[:3000] == [encode_string(str(k)) for k in range(3000)]
    assert recovery.messages == len(found)
    assert len(found) == 3000 or period < 1.0


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
from seft_msgs_py.errors import SeftError
from seft_msgs_py.wire.messages import encode_string
from seft_msgs_py.wire.topics import DESCRIPTION
from seft_ros.bags import bag_writer
from seft_ros.bags.bag_files import Bag
bag_writer.FLUSH_PERIOD = {period}
bag_writer.tempfile.tempdir = "."
bag = bag_writer.BagWriter("bag")
for k in range({count}):
    bag.write(DESCRIPTION, encode_string(f"{{k:1000}}"), k)
print(bag.trouble)
try:
    print(bag.{end}())
except SeftError as error:
    print(error.exit_status, error)
with Bag("bag") as found:
    print(found.counts.total(), found.damage)
"""


def little_room(tmp_path, size, **words):
    script = LITTLE_ROOM.format(paths=[p for p in sys.path if p], **{"period": 0.0} | words)
    return run_on_a_disk(f"size={size}", tmp_path, "-c", script).splitlines()


@pytest.mark.parametrize("period", [0.0, 3600.0], ids=["seen in time", "seen too late"])
def test_what_a_full_disk_does_not_take_goes_into_the_room_that_was_reserved(tmp_path, period):
    trouble, saved, found = little_room(tmp_path, "16m", period=period, count=9000, end="save")
    assert trouble == "bag: No space left on device"
    assert (saved, found) == ("bag", "9000 []")


def test_what_has_no_room_at_all_is_told_and_the_bag_can_be_read_so_far(tmp_path):
    _, saved, found = little_room(tmp_path, "16m", period=3600.0, count=30_000, end="save")
    assert saved.startswith("1 the bag can't be saved: ")
    assert saved.endswith(": No space left on device")
    count, damage = found.split(" ", 1)
    assert int(count) > 9000
    assert "cut off" in damage


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
