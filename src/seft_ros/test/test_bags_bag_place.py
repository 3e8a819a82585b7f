import os
import resource

from recordings_at_hand import run_on_a_disk
from seft_ros.bags import bag_writer
from seft_ros.bags.bag_writer import why_not_writable

ASK = """
import sys
from pathlib import Path
from seft_ros.bags.bag_writer import why_not_writable
print(why_not_writable(Path(sys.argv[1])))
"""


def asked_on(options, folder, place):
    """Ask on a file system of its own, mounted with options."""
    return run_on_a_disk(options, folder, "-c", ASK, place)


def test_there_is_a_place_in_a_folder_that_is_there_or_can_be_made(tmp_path):
    assert why_not_writable(tmp_path / "bag") == ""
    assert why_not_writable(tmp_path / "some" / "bags" / "bag") == ""
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_is_taken_is_reported(tmp_path):
    (tmp_path / "dangling").symlink_to("nowhere")
    for place in (tmp_path, tmp_path / "dangling"):
        assert why_not_writable(place) == f"{place} exists already"


def test_a_file_in_the_way_and_a_name_that_no_disk_takes_are_reported(tmp_path):
    (tmp_path / "bags").write_text("")
    assert why_not_writable(tmp_path / "bags" / "bag") == (
        f"nothing can be written in {tmp_path / 'bags'} (Not a directory)"
    )
    assert "File name too long" in why_not_writable(tmp_path / ("b" * 300))


def test_a_folder_without_rights_is_reported(tmp_path):
    message = "nothing can be written in {} ({})"
    there = asked_on("ro", tmp_path, "bags/bag")
    assert there == message.format(tmp_path, "Read-only file system")
    if os.getuid() == 0:
        return  # may write anywhere
    tmp_path.chmod(0o500)
    assert why_not_writable(tmp_path / "bag") == message.format(tmp_path, "Permission denied")


def test_a_disk_without_room_for_more_files_is_reported(tmp_path):
    there = asked_on("size=20m,nr_inodes=6", tmp_path, "bag")
    assert there == f"nothing can be written in {tmp_path} (No space left on device)"


def test_a_limit_of_the_size_of_a_file_is_reported(tmp_path, monkeypatch):
    limits = {resource.RLIMIT_FSIZE: (10**6, resource.RLIM_INFINITY)}
    monkeypatch.setattr(bag_writer.resource, "getrlimit", limits.get)
    assert why_not_writable(tmp_path / "bag") == (
        "a file may have 1 MB by a limit of this process (ulimit -f), and the bag needs 17 MB"
    )


def test_a_disk_without_room_for_the_bag_is_reported(tmp_path):
    why = f"{tmp_path} has room for 10 MB, and the bag needs 17 MB"
    assert asked_on("size=10m", tmp_path, "bag") == why
    assert asked_on("size=20m", tmp_path, "bag") == ""
