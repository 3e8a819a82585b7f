"""What killed nodes leave in /dev/shm.

FastDDS takes a node's files away when the node ends, not when it is killed. They are of the
process that mapped them; other tests on this host have files there too, so that only those are
removed that a process of this run had, and that no living process has.
"""

import contextlib
import fcntl
import os
from collections.abc import Iterable
from pathlib import Path

FOLDER = Path("/dev/shm")
_PREFIX, _MUTEX = "fastrtps_", "sem."
_COMPANIONS = ("{}", "{}_el", "{}_sl", "sem.{}_mutex")
"""A segment or port, its exclusive and its shared lock, its mutex."""


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
        """Remove what was noted and is nobody's now; give the names of the files.

        To be called when this process has left the graph: FastDDS keeps the segments of others
        mapped that it has read from, so that this process does not count.
        """
        in_use: set[str] = set()
        if self._names:
            for entry in self._proc.iterdir():
                if entry.name.isdigit() and int(entry.name) != os.getpid():
                    in_use |= self._mapped_by(int(entry.name))
        removed = []
        for name in sorted(self._names - in_use):
            files = [self._folder / companion.format(name) for companion in _COMPANIONS]
            if any(_is_locked(file) for file in files):
                continue  # by a process that we may not look into
            for file in files:
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


def _is_locked(file: Path) -> bool:
    """Tell whether a living process holds the lock of a file, as FastDDS does with its own."""
    try:
        handle = os.open(file, os.O_RDONLY)
    except OSError:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(handle)
    return False
