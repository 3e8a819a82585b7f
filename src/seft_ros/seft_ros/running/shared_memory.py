"""What killed nodes leave in /dev/shm.

FastDDS takes a process's files away when it ends, not when it is killed; then its peers can't take
away theirs altogether either. Other tests on this host have files there too, so that only those
are removed that a process of this run had mapped, and whose reader is dead: it holds a lock of
them as long as it lives, which is also how FastDDS itself tells. A process may also have died
before anybody saw what it had: what has come up since, and nobody at all has any more, goes too.

Ports are shared by tests in all ROS domains of a host. FastDDS opens and closes one only while it
holds its mutex, and so must who removes one: else a reader that just comes up would listen to a
port that nobody finds.
"""

import contextlib
import ctypes
import fcntl
import os
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

FOLDER = Path("/dev/shm")
_PREFIX, _MUTEX = "fastrtps_", "sem."
_LOCKS = ("{}_el", "{}_sl")  # of one reader, of several
_OTHERS = ("{}", "sem.{}_mutex")  # a segment or port, its mutex
_DEAD = 2.0  # s for which FastDDS waits before it takes a mutex's owner for dead
_LOOK = 0.01  # s


class SharedMemory:
    """Segments and ports of FastDDS that some processes have had.

    Parameters
    ----------
    proc : Path
        Where the kernel tells of processes.
    folder : Path
        Where the files are.
    """

    def __init__(self, proc: Path = Path("/proc"), folder: Path = FOLDER) -> None:
        self._proc, self._folder = proc, folder
        self._names: set[str] = set()
        self._before = self._present()

    def look(self, pids: Iterable[int]) -> None:
        """Note what living processes have; a dead one can't be asked any more."""
        for pid in pids:
            self._names |= self._mapped_by(pid)

    def clean(self) -> list[str]:
        """Remove what was noted and has no living reader; give the names of the files."""
        new = self._present() - self._before  # before the look at processes: theirs are seen there
        self._names |= new - set().union(*map(self._mapped_by, self._living()))
        removed = []
        for name in sorted(self._names):
            locks = [self._folder / lock.format(name) for lock in _LOCKS]
            with contextlib.ExitStack() as held:
                # held until all is gone, so that nobody takes the name meanwhile
                held.enter_context(_mutex(name))
                if not all(held.enter_context(_taken(lock)) for lock in locks):
                    continue
                for file in (*(self._folder / other.format(name) for other in _OTHERS), *locks):
                    with contextlib.suppress(OSError):
                        file.unlink()
                        removed.append(file.name)
        self._names.clear()
        return removed

    def _mapped_by(self, pid: int) -> set[str]:
        try:
            maps = (self._proc / str(pid) / "maps").read_text(errors="replace")
        except OSError:
            return set()
        start = f"{self._folder}/"
        return _names(
            line.split(start, 1)[1].split(" ")[0] for line in maps.splitlines() if start in line
        )

    def _living(self) -> list[int]:
        return [int(entry.name) for entry in self._proc.iterdir() if entry.name.isdigit()]

    def _present(self) -> set[str]:
        return _names(entry.name for entry in self._folder.iterdir())


def _names(files: Iterable[str]) -> set[str]:
    """Segments and ports that some files belong to."""
    found = set()
    for file in files:
        name = file.removeprefix(_MUTEX)
        for end in ("_mutex", "_el", "_sl"):
            name = name.removesuffix(end)
        if name.startswith(_PREFIX):
            found.add(name)
    return found


@contextlib.contextmanager
def _mutex(name: str) -> Iterator[None]:
    """Hold the mutex of a port, if there is one; it is a named semaphore of POSIX."""
    libc = ctypes.CDLL(None)
    libc.sem_open.restype = ctypes.c_void_p
    semaphore = ctypes.c_void_p(libc.sem_open(f"/{name}_mutex".encode(), 0))
    if not semaphore:
        yield
        return
    deadline = time.monotonic() + _DEAD
    while not (held := libc.sem_trywait(semaphore) == 0) and time.monotonic() < deadline:
        time.sleep(_LOOK)
    try:
        yield
    finally:
        if held:
            libc.sem_post(semaphore)
        libc.sem_close(semaphore)


@contextlib.contextmanager
def _taken(lock: Path) -> Iterator[bool]:
    """Hold the lock of a file, if there is one; tell whether no living process has it."""
    try:
        handle = os.open(lock, os.O_RDONLY)
    except FileNotFoundError:
        yield True
        return
    except OSError:  # of somebody else
        yield False
        return
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        yield False
    else:
        yield True
    finally:
        os.close(handle)
