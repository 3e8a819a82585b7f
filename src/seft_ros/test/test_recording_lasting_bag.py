import shutil

import pytest
from rosbags.rosbag2 import Reader
from seft_msgs_py.errors import ExperimentError
from seft_msgs_py.wire.messages import encode_string
from seft_msgs_py.wire.topics import DESCRIPTION, DIAGNOSTICS
from seft_ros.recording import lasting_bag
from seft_ros.recording.lasting_bag import LastingBag

STORAGES = ("mcap", "sqlite3")
HALF = 400
MESSAGES = [(t, encode_string(str(k)), k) for k in range(HALF) for t in (DESCRIPTION, DIAGNOSTICS)]


def contents(path):
    with Reader(path) as reader:
        return sorted((t, c.topic, bytes(raw)) for c, t, raw in reader.messages())


ALL = sorted((k, "/" + topic.name, raw) for topic, raw, k in MESSAGES)


@pytest.fixture(params=STORAGES)
def storage(request):
    return request.param


@pytest.fixture(autouse=True)
def at_each_look(monkeypatch):
    monkeypatch.setattr(lasting_bag, "FLUSH_PERIOD", 0.0)


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


def move_the_file(bag):
    (file,) = bag.iterdir()
    file.rename(bag / "elsewhere")
    return "is not in its folder", bag.with_name("bag_saved")


@pytest.mark.parametrize(
    "lose", [delete, delete_all_bags, delete_the_file, put_another_there, move_the_file]
)
def test_a_bag_that_is_lost_is_told_and_whole_in_the_end(tmp_path, storage, lose):
    bag = LastingBag(tmp_path / "bags" / "bag", storage)
    for message in MESSAGES[:HALF]:
        bag.write(*message)
    bag.look()
    assert bag.trouble == ""
    told, saved = lose(tmp_path / "bags" / "bag")
    bag.look()
    assert told in bag.trouble
    for message in MESSAGES[HALF:]:
        bag.write(*message)
    assert bag.close() == saved
    assert contents(saved) == ALL


def test_a_bag_that_is_moved_is_whole_where_it_is(tmp_path, storage):
    bag = LastingBag(tmp_path / "bag", storage)
    for message in MESSAGES[:HALF]:
        bag.write(*message)
    (tmp_path / "bag").rename(tmp_path / "other")
    bag.look()
    assert bag.trouble.endswith(f"bag was moved to {tmp_path / 'other'}")
    for message in MESSAGES[HALF:]:
        bag.write(*message)
    saved = bag.close()
    assert contents(saved) == ALL
    # sqlite3 writes no more to a file that was moved
    assert saved == tmp_path / ("other" if storage == "mcap" else "bag")


def test_where_no_bag_can_be_made_all_is_kept_until_there_is_a_place(tmp_path, monkeypatch):
    monkeypatch.setattr(lasting_bag.tempfile, "gettempdir", lambda: str(tmp_path / "bags"))
    (tmp_path / "bags").write_text("a file in the way")
    bag = LastingBag(tmp_path / "bags" / "bag", "mcap")
    assert "Not a directory" in bag.trouble
    for message in MESSAGES:
        bag.write(*message)
    for _ in range(2):
        with pytest.raises(ExperimentError, match=r"can't be saved.*Not a directory"):
            bag.close()
    (tmp_path / "bags").unlink()
    assert contents(bag.close()) == ALL


def test_memory_that_is_used_up_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(lasting_bag, "MOST_IN_MEMORY", 1000)
    (tmp_path / "bags").write_text("a file in the way")
    bag = LastingBag(tmp_path / "bags" / "bag", "mcap")
    bag.write(DESCRIPTION, bytes(900), 0)
    assert not bag.is_full
    bag.write(DESCRIPTION, bytes(900), 0)
    assert bag.is_full
