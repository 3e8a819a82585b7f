import fcntl

import pytest
from seft_ros.running.shared_memory import SharedMemory

SEGMENT, PORT = "fastrtps_0123456789abcdef", "fastrtps_port7412"
OF_SEGMENT = {SEGMENT, f"{SEGMENT}_el"}
OF_PORT = {PORT, f"{PORT}_el", f"sem.{PORT}_mutex"}


@pytest.fixture
def host(tmp_path):
    """A /proc and a /dev/shm: process 10 has a segment and a port, 11 the port."""
    proc, folder = tmp_path / "proc", tmp_path / "shm"
    folder.mkdir()
    for name in OF_SEGMENT | OF_PORT:
        (folder / name).touch()
    for pid, names in ((10, [SEGMENT, PORT, f"sem.{PORT}_mutex"]), (11, [PORT])):
        (proc / str(pid)).mkdir(parents=True)
        lines = [f"7f00-7f01 rw-s 00000000 00:19 5    {folder}/{name}\n" for name in names]
        lines.append("7f02-7f03 r--p 00000000 00:19 5    /usr/lib/libc.so\n")
        (proc / str(pid) / "maps").write_text("".join(lines))
    return proc, folder


def left(folder):
    return {file.name for file in folder.iterdir()}


def die(proc, pid):
    (proc / str(pid) / "maps").unlink()


def test_what_a_dead_process_had_alone_is_removed_and_what_others_use_stays(host):
    proc, folder = host
    memory = SharedMemory(proc, folder)
    memory.look([10])
    die(proc, 10)
    assert set(memory.clean()) == OF_SEGMENT
    assert left(folder) == OF_PORT
    die(proc, 11)
    assert memory.clean() == []  # of another process; noted no more


def test_the_last_one_takes_the_port_away(host):
    proc, folder = host
    memory = SharedMemory(proc, folder)
    memory.look([10, 11])
    die(proc, 10)
    die(proc, 11)
    memory.clean()
    assert left(folder) == set()


def test_nothing_of_a_living_or_an_unknown_process_is_touched(host):
    proc, folder = host
    (folder / "fastrtps_fedcba9876543210").touch()
    memory = SharedMemory(proc, folder)
    memory.look([10, 99])
    before = left(folder)
    assert memory.clean() == []
    assert left(folder) == before


def test_what_somebody_holds_a_lock_of_stays(host):
    proc, folder = host
    memory = SharedMemory(proc, folder)
    memory.look([10])
    die(proc, 10)
    with (folder / f"{SEGMENT}_el").open() as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        assert memory.clean() == []
    assert left(folder) >= OF_SEGMENT
