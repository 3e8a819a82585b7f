"""A bag whose place is lost while it is written."""

import os
import shutil

import bags_at_hand
import pytest
from seft_msgs_py.errors import ExperimentError
from seft_msgs_py.wire.messages import encode_string
from seft_msgs_py.wire.topics import DESCRIPTION, DIAGNOSTICS
from seft_ros.bags import bag_writer
from seft_ros.bags.bag_files import Bag
from seft_ros.bags.bag_writer import BagWriter

HALF = 400
MESSAGES = [(t, encode_string(str(k)), k) for k in range(HALF) for t in (DESCRIPTION, DIAGNOSTICS)]
ALL = sorted((k, "/" + topic.name, raw) for topic, raw, k in MESSAGES)


def contents(path):
    with Bag(path) as bag:
        assert bag.damage == []
    return sorted((t, topic, raw) for topic, t, raw in bags_at_hand.contents(path))


def delete(bag):
    shutil.rmtree(bag)
    return "was deleted", bag


def delete_all_bags(bag):
    shutil.rmtree(bag.parent)
    return "was deleted", bag


def delete_the_file(bag):
    (file,) = bag.iterdir()
    file.unlink()
    return "was deleted", bag.with_name("bag_saved")


def put_another_there(bag):
    shutil.rmtree(bag)
    bag.mkdir()
    return "was deleted", bag.with_name("bag_saved")


def move(bag):
    bag.rename(bag.with_name("other"))
    return f"was moved: its file is {bag.with_name('other')}", bag


def move_the_file(bag):
    (file,) = bag.iterdir()
    file.rename(bag / "elsewhere")
    return f"was moved: its file is {bag / 'elsewhere'}", bag.with_name("bag_saved")


@pytest.mark.parametrize(
    "lose", [delete, delete_all_bags, delete_the_file, put_another_there, move, move_the_file]
)
def test_a_bag_that_is_lost_is_reported_and_whole_in_the_end(tmp_path, lose):
    bag = BagWriter(tmp_path / "bags" / "bag")
    for message in MESSAGES[:HALF]:
        bag.write(*message)
    bag.flush()
    assert bag.trouble == ""
    expected, saved = lose(tmp_path / "bags" / "bag")
    bag.flush()
    assert expected in bag.trouble
    for message in MESSAGES[HALF:]:
        bag.write(*message)
    assert bag.save() == saved
    assert contents(saved) == ALL


@pytest.mark.parametrize("size", [0, 9000])
def test_a_bag_whose_file_is_cut_off_is_reported_and_the_remainder_is_read(tmp_path, size):
    bag = BagWriter(tmp_path / "bag")
    for message in MESSAGES[:HALF]:
        bag.write(*message)
    bag.flush()
    os.truncate(tmp_path / "bag" / "bag.mcap", size)
    bag.flush_if_due()
    for message in MESSAGES[HALF:]:
        bag.write(*message)
    bag.flush()
    assert "its file was cut off" in bag.trouble
    assert bag.save() == tmp_path / "bag"
    with Bag(tmp_path / "bag") as found:
        assert found.damage
        assert found.counts.total() == HALF


def test_where_no_bag_can_be_made_all_is_kept_until_there_is_a_place(tmp_path, monkeypatch):
    monkeypatch.setattr(bag_writer.tempfile, "gettempdir", lambda: str(tmp_path / "bags"))
    (tmp_path / "bags").write_text("a file in the way")
    bag = BagWriter(tmp_path / "bags" / "bag")
    assert "Not a directory" in bag.trouble
    for message in MESSAGES:
        bag.write(*message)
    for _ in range(2):
        with pytest.raises(ExperimentError, match=r"can't be saved.*Not a directory"):
            bag.save()
    (tmp_path / "bags").unlink()
    assert contents(bag.save()) == ALL


def test_memory_that_is_used_up_is_reported(tmp_path, monkeypatch):
    monkeypatch.setattr(bag_writer, "MAX_IN_MEMORY", 1000)
    (tmp_path / "bags").write_text("a file in the way")
    bag = BagWriter(tmp_path / "bags" / "bag")
    bag.write(DESCRIPTION, bytes(900), 0)
    assert not bag.is_full
    bag.write(DESCRIPTION, bytes(900), 0)
    assert bag.is_full
