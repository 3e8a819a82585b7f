"""What killed nodes leave in /dev/shm.

FastDDS takes a process's files away when it ends, not when it is killed; then its peers can't take
away theirs altogether either. Other tests on this host have files there too, so that only those
are removed that a process of this run had mapped, and whose reader is dead: it holds a lock of
them as long as it lives, which is also how FastDDS itself tells.
"""

import contextlib
import fcntl
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

FOLDER = Path("/dev/shm")
_PREFIX, _MUTEX = "fastrtps_", "sem."
_LOCKS = ("{}_el", "{}_sl")  # of one reader, of several
_OTHERS = ("{}", "sem.{}_mutex")  # a segment or port, its mutex


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

    def look(self, pids: Iterable[int]) -> None:
        """Note what living processes have; a dead one can't be asked any more."""
        for pid in pids:
            self._names |= self._mapped_by(pid)

    def clean(self) -> list[str]:
        """Remove what was noted and has no living reader; give the names of the files."""
        removed = []
        for name in sorted(self._names):
            locks = [self._folder / lock.format(name) for lock in _LOCKS]
            with contextlib.ExitStack() as held:
                # held until all is gone, so that nobody takes the name meanwhile
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
        files = {
            line.split(start, 1)[1].split(" ")[0] for line in maps.splitlines() if start in line
        }
        names = {file.removeprefix(_MUTEX).removesuffix("_mutex") for file in files}
        return {name for name in names if name.startswith(_PREFIX)}


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
