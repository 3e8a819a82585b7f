import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from rosbags.rosbag2 import Reader
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import ExperimentError
from seft_msgs_py.wire.messages import encode_string
from seft_msgs_py.wire.topics import DESCRIPTION, DIAGNOSTICS
from seft_ros.bags import lasting_bag
from seft_ros.bags.lasting_bag import LastingBag, expected_size, obstacle
from seft_ros.bags.record_bag import write_record
from seft_ros.test_run.compiled_loop import build_blocks
from seft_ros.test_run.offline import simulate
from seft_ros.test_run.parameter_tables import TABLES

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
def at_each_poll(monkeypatch):
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
def test_a_bag_that_is_lost_is_told_and_whole_in_the_end(tmp_path, storage, lose):
    bag = LastingBag(tmp_path / "bags" / "bag", storage)
    for message in MESSAGES[:HALF]:
        bag.write(*message)
    bag.poll()
    assert bag.trouble == ""
    told, saved = lose(tmp_path / "bags" / "bag")
    bag.poll()
    assert told in bag.trouble
    for message in MESSAGES[HALF:]:
        bag.write(*message)
    assert bag.close() == saved
    assert contents(saved) == ALL


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


CONFIG = Path(__file__).resolve().parents[3] / "config"
ASK = """
import sys
from pathlib import Path
from seft_ros.bags.lasting_bag import obstacle
print(obstacle(Path(sys.argv[1]), int(sys.argv[2])))
"""


def asked_on(options, folder, place, expected=0):
    """Ask on a file system of its own, mounted with options."""
    shell = 'mount -t tmpfs -o "$1" tmpfs "$2" && cd "$2" && exec "$3" -c "$4" "$5" "$6"'
    words = ["unshare", "-m", "sh", "-c", shell, "sh", options, folder]
    words += [sys.executable, ASK, place, str(expected)]
    done = subprocess.run(words, capture_output=True, text=True)
    if "unshare" in done.stderr or "mount:" in done.stderr:
        pytest.skip("may not mount a file system here")
    assert done.stderr == ""
    return done.stdout.strip()


def test_there_is_a_place_in_a_folder_that_is_there_or_can_be_made(tmp_path):
    assert obstacle(tmp_path / "bag") == ""
    assert obstacle(tmp_path / "some" / "bags" / "bag") == ""
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_is_taken_is_told(tmp_path):
    (tmp_path / "dangling").symlink_to("nowhere")
    for place in (tmp_path, tmp_path / "dangling"):
        assert obstacle(place) == f"{place} exists already"


def test_a_file_in_the_way_and_a_name_that_no_disk_takes_are_told(tmp_path):
    (tmp_path / "bags").write_text("")
    assert obstacle(tmp_path / "bags" / "bag") == (
        f"nothing can be written in {tmp_path / 'bags'} (Not a directory)"
    )
    assert "File name too long" in obstacle(tmp_path / ("b" * 300))


def test_a_folder_without_rights_is_told(tmp_path):
    told = "nothing can be written in {} ({})"
    there = asked_on("ro", tmp_path, "bags/bag")
    assert there == told.format(tmp_path, "Read-only file system")
    if os.getuid() == 0:
        return  # may write anywhere
    tmp_path.chmod(0o500)
    assert obstacle(tmp_path / "bag") == told.format(tmp_path, "Permission denied")


def test_a_disk_without_room_for_the_bag_is_told(tmp_path):
    assert asked_on("size=10m", tmp_path, "bag") == (
        f"{tmp_path} has room for 10 MB, and the bag needs 17 MB"
    )
    assert asked_on("size=20m", tmp_path, "bag") == ""
    assert asked_on("size=20m", tmp_path, "bag", 10_000_000).endswith("the bag needs 27 MB")


def test_the_size_of_a_test_is_foreseen(tmp_path):
    experiment = Experiment.load(TABLES, [CONFIG / "jhu.yaml"])
    blocks = build_blocks(experiment)
    chunks = blocks.ground_motion.chunks
    write_record(simulate(experiment, blocks), tmp_path / "bag", ground_motion=chunks)
    size = sum(file.stat().st_size for file in (tmp_path / "bag").iterdir())
    force, steps = experiment["reference_force"], blocks.ground_motion.steps
    expected = expected_size(force, experiment.axes, experiment.timebase, steps)
    assert 0.8 * size < expected < 1.2 * size
