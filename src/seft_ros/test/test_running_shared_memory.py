import ctypes
import fcntl
import os
import threading
from contextlib import contextmanager

import pytest
from seft_ros.running.shared_memory import SharedMemory

SEGMENT, PORT = "fastrtps_0123456789abcdef", "fastrtps_port7412"
OF_SEGMENT = {SEGMENT, f"{SEGMENT}_el"}
OF_PORT = {PORT, f"{PORT}_el", f"sem.{PORT}_mutex"}


@pytest.fixture
def host(tmp_path):
    """A /proc and a /dev/shm: process 10 has a segment and a port, 11 writes to the port."""
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


@contextmanager
def living_reader(folder, name, how=fcntl.LOCK_EX):
    """Hold the lock that FastDDS holds while a reader lives."""
    with (folder / name).open() as held:
        fcntl.flock(held, how)
        yield


def test_what_a_dead_process_had_is_removed_though_others_still_write_to_it(host):
    proc, folder = host
    memory = SharedMemory(proc, folder)
    memory.look([10])
    (proc / "10" / "maps").unlink()
    assert set(memory.clean()) == OF_SEGMENT | OF_PORT
    assert left(folder) == set()
    assert memory.clean() == []  # noted no more


def test_what_a_living_process_reads_stays(host):
    proc, folder = host
    memory = SharedMemory(proc, folder)
    memory.look([10, 11])
    with living_reader(folder, f"{PORT}_el"):
        assert set(memory.clean()) == OF_SEGMENT
    assert left(folder) == OF_PORT


def test_what_several_read_stays_until_the_last_has_ended(host):
    proc, folder = host
    (folder / f"{PORT}_sl").touch()
    memory = SharedMemory(proc, folder)
    memory.look([10])
    with living_reader(folder, f"{PORT}_sl", fcntl.LOCK_SH):
        assert set(memory.clean()) == OF_SEGMENT
    memory.look([11])
    memory.clean()
    assert left(folder) == set()


def test_nothing_of_an_unknown_process_is_touched(host):
    proc, folder = host
    memory = SharedMemory(proc, folder)
    memory.look([99])
    before = left(folder)
    assert memory.clean() == []
    assert left(folder) == before


def test_what_came_up_since_and_nobody_has_any_more_is_removed_though_nobody_saw_who_had_it(host):
    proc, folder = host
    memory = SharedMemory(proc, folder)
    unseen, living, locked = "fastrtps_dead", "fastrtps_living", "fastrtps_locked"
    for name in (unseen, living, locked):
        (folder / name).touch()
        (folder / f"{name}_el").touch()
    (proc / "12").mkdir()
    (proc / "12" / "maps").write_text(f"7f00-7f01 rw-s 00000000 00:19 5    {folder}/{living}\n")
    with living_reader(folder, f"{locked}_el"):  # by a process that can't be seen from here
        assert set(memory.clean()) == {unseen, f"{unseen}_el"}
    assert left(folder) >= OF_SEGMENT | OF_PORT


def test_a_port_is_left_alone_while_somebody_opens_or_closes_it(tmp_path):
    name = f"fastrtps_port{os.getpid()}_of_a_test"
    memory = SharedMemory(folder=tmp_path)
    (tmp_path / name).touch()
    libc = ctypes.CDLL(None)
    libc.sem_open.restype = ctypes.c_void_p
    mutex = ctypes.c_void_p(libc.sem_open(f"/{name}_mutex".encode(), os.O_CREAT, 0o600, 0))
    cleaning = threading.Thread(target=memory.clean)
    try:
        cleaning.start()
        cleaning.join(0.2)
        assert (cleaning.is_alive(), (tmp_path / name).exists()) == (True, True)
        libc.sem_post(mutex)
        cleaning.join()
        assert not (tmp_path / name).exists()
    finally:
        libc.sem_close(mutex)
        libc.sem_unlink(f"/{name}_mutex".encode())
