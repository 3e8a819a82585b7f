"""`seft compare` on bags of all sorts, those of ros2 bag record among them."""

import dataclasses
import json
import shutil

import numpy as np
import pytest
import yaml
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.wire.messages import encode_string
from seft_msgs_py.wire.topics import CLOCK, DESCRIPTION, GROUND_MOTION, LOOP_TOPICS, STRING
from seft_ros.bags.record import Record, Series
from seft_ros.bags.record_bag import write_record

COUNT = 60
FOREVER = QosTime(9223372036, 854775807)
QOS = Qos(
    QosHistory.UNKNOWN,
    0,
    QosReliability.RELIABLE,
    QosDurability.VOLATILE,
    FOREVER,
    FOREVER,
    QosLiveliness.AUTOMATIC,
    FOREVER,
    False,
)
"""As discovery tells it to the stock recorder."""
STORE = get_typestore(Stores.ROS2_JAZZY)


@pytest.fixture
def record():
    rng = np.random.default_rng(3)
    steps = np.arange(COUNT)
    series = {
        topic.name: Series(steps, rng.normal(size=(COUNT, len(topic.quantities), 2)))
        for topic in LOOP_TOPICS
    }
    return Record(Experiment({"rig": {"rate": 500.0, "axes": ["x", "y"]}}), series)


def write(path, record):
    motion = record.series[GROUND_MOTION.name].values[:, 0]
    write_record(record, path, [(0, motion[:40]), (40, motion[40:])])
    return path


def altered(record, topic="rig/state", step=41, row=3, axis=1):
    values = record.series[topic].values.copy()
    values[step, row, axis] = np.nextafter(values[step, row, axis], np.inf)
    series = {**record.series, topic: Series(record.series[topic].steps, values)}
    return dataclasses.replace(record, series=series)


def ros2_bag_record(bag, path, *, files=1, without=(), prefix=""):
    """Record what a bag holds once more, as the stock recorder does it in split files."""
    with Reader(bag) as reader:
        messages = [
            (prefix + item.topic, item.msgtype, time, raw)
            for item, time, raw in reader.messages()
            if item.topic not in without
        ]
    start = messages[0][2]
    messages += [
        ("/rosout", STRING, start, encode_string("log")),
        ("/parameter_events", STRING, start, encode_string("event")),
        ("/clock", CLOCK, start + 9, b"\x00\x01\x00\x00" + bytes(8)),
    ]
    messages.sort(key=lambda message: message[2])
    infos = []
    path.mkdir()
    for index, part in enumerate(np.array_split(np.arange(len(messages)), files)):
        folder = path.with_name(f"{path.name}_{index}")
        with Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
            topics = {
                name: writer.add_connection(name, kind, typestore=STORE, offered_qos_profiles=[QOS])
                for name, kind in dict.fromkeys(message[:2] for message in messages)
            }
            for name, _, time, raw in (messages[k] for k in part):
                writer.write(topics[name], time, raw)
        tree = yaml.safe_load((folder / "metadata.yaml").read_text())
        infos.append(tree["rosbag2_bagfile_information"])
        (folder / "metadata.yaml").unlink()
        for file in folder.iterdir():
            shutil.move(file, path / file.name)
        folder.rmdir()
    whole = infos[0]
    whole["message_count"] = len(messages)
    whole["relative_file_paths"] = [p for info in infos for p in info["relative_file_paths"]]
    whole["duration"]["nanoseconds"] = messages[-1][2] - start
    for k, topic in enumerate(whole["topics_with_message_count"]):
        topic["message_count"] = sum(
            info["topics_with_message_count"][k]["message_count"] for info in infos
        )
    text = yaml.safe_dump({"rosbag2_bagfile_information": whole})
    (path / "metadata.yaml").write_text(text)
    return path


def compared(seft, *words):
    status, out, err = seft("compare", *words, "--json")
    assert err == ""
    result = json.loads(out)
    assert status == (0 if result["identical"] else 1)
    return result


def test_a_bag_of_the_stock_recorder_is_the_same_test(seft, tmp_path, record):
    """Of all storages and compressions, see test_bags_record_bag_reader.py."""
    bag = write(tmp_path / "ours", record)
    ros2_bag_record(bag, tmp_path / "stock", files=3)
    result = compared(seft, "ours", "stock")
    assert result["identical"] is True
    assert result["topics"]["rig/state"]["samples_b"] == COUNT


def test_metadata_may_tell_another_quality_of_service_than_the_files(seft, tmp_path, record):
    bag = write(tmp_path / "ours", record)
    path = ros2_bag_record(bag, tmp_path / "stock", files=2) / "metadata.yaml"
    tree = yaml.safe_load(path.read_text())
    for topic in tree["rosbag2_bagfile_information"]["topics_with_message_count"]:
        topic["topic_metadata"]["offered_qos_profiles"] *= 2
    path.write_text(yaml.safe_dump(tree))
    assert compared(seft, "ours", "stock")["identical"] is True


def test_topics_may_be_in_a_namespace(seft, tmp_path, record):
    ros2_bag_record(write(tmp_path / "ours", record), tmp_path / "stock", prefix="/lab")
    assert compared(seft, "ours", "stock")["identical"] is True


def test_a_bag_with_no_topic_of_a_test_is_refused_in_one_line(seft, tmp_path, record):
    bag = write(tmp_path / "ours", record)
    with Reader(bag) as reader:
        ours = [connection.topic for connection in reader.connections]
    kept = "/diagnostics"
    ros2_bag_record(bag, tmp_path / "stock", without=[name for name in ours if name != kept])
    status, out, err = seft("compare", "ours", "stock")
    assert (status, out) == (2, "")
    assert err.startswith("seft: stock: the bag holds no test")
    assert err.count("\n") == 1


def test_a_report_needs_the_configuration_and_says_so(seft, tmp_path, record):
    bag = write(tmp_path / "ours", record)
    ros2_bag_record(bag, tmp_path / "bare", without=["/" + DESCRIPTION.name])
    status, out, err = seft("report", "bare")
    assert (status, out) == (2, "")
    assert "experiment/description" in err
    assert err.count("\n") == 1
    ros2_bag_record(bag, tmp_path / "full", files=2)
    assert seft("report", "full", "--json")[0] == 0


def test_two_bags_are_drawn(seft, tmp_path, record):
    write(tmp_path / "one", record)
    write(tmp_path / "two", altered(record))
    result = compared(seft, "one", "two", "--figure", "tests.png")
    assert [bag["bag"] for bag in result["bags"]] == ["one", "two"]
    assert result["figure"] == "tests.png"
    assert (tmp_path / "tests.png").read_bytes().startswith(b"\x89PNG")
    status, out, _ = seft("compare", "one", "two")
    assert status == 1
    assert "first difference at step 41, rig/state" in out


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["one"], "Missing argument"),
        (["one", "one", "--figure", "none/figure.png"], "no folder none"),
        (["one", "one", "--figure", "figure.xyz"], "figures end in"),
    ],
)
def test_wrong_use_is_refused_in_one_line(seft, tmp_path, record, words, told):
    write(tmp_path / "one", record)
    status, out, err = seft("compare", *words)
    assert (status, out) == (2, "")
    assert told in err
    assert err.count("\n") == 1
