import os
import subprocess
import sys
from pathlib import Path

import pytest
from seft_msgs_py.config.experiment import Experiment
from seft_ros.bags.bag_place import expected_size, why_not_writable
from seft_ros.bags.record_bag import write_record
from seft_ros.test_run.compiled_loop import build_blocks
from seft_ros.test_run.offline import simulate_test
from seft_ros.test_run.parameter_tables import TABLES

CONFIG = Path(__file__).resolve().parents[3] / "config"
ASK = """
import sys
from pathlib import Path
from seft_ros.bags.bag_place import why_not_writable
print(why_not_writable(Path(sys.argv[1]), int(sys.argv[2])))
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
    assert why_not_writable(tmp_path / "bag") == ""
    assert why_not_writable(tmp_path / "some" / "bags" / "bag") == ""
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_is_taken_is_told(tmp_path):
    (tmp_path / "dangling").symlink_to("nowhere")
    for place in (tmp_path, tmp_path / "dangling"):
        assert why_not_writable(place) == f"{place} exists already"


def test_a_file_in_the_way_and_a_name_that_no_disk_takes_are_told(tmp_path):
    (tmp_path / "bags").write_text("")
    assert why_not_writable(tmp_path / "bags" / "bag") == (
        f"nothing can be written in {tmp_path / 'bags'} (Not a directory)"
    )
    assert "File name too long" in why_not_writable(tmp_path / ("b" * 300))


def test_a_folder_without_rights_is_told(tmp_path):
    told = "nothing can be written in {} ({})"
    there = asked_on("ro", tmp_path, "bags/bag")
    assert there == told.format(tmp_path, "Read-only file system")
    if os.getuid() == 0:
        return  # may write anywhere
    tmp_path.chmod(0o500)
    assert why_not_writable(tmp_path / "bag") == told.format(tmp_path, "Permission denied")


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
    write_record(simulate_test(experiment, blocks), tmp_path / "bag", ground_motion=chunks)
    size = sum(file.stat().st_size for file in (tmp_path / "bag").iterdir())
    force, steps = experiment["reference_force"], blocks.ground_motion.steps
    expected = expected_size(force, experiment.axes, experiment.timebase, steps)
    assert 0.8 * size < expected < 1.2 * size
