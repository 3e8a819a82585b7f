"""The place of a bag that is to be recorded: whether one can be made there, and has room."""

import os
import resource
import shutil
import tempfile
from contextlib import ExitStack, suppress
from pathlib import Path

from seft_ros.bags.bag_writer import RESERVED, file_reason

_LEFT = 4 << 20  # bytes that must stay free beside the bag, for other files of a test
_FILES = 8  # that can be made: the bag's folder, its files, and those of the test


def why_not_writable(place: Path) -> str:
    """Say why no bag can be made in a folder that is to be made; empty if it can."""
    folder = place.absolute().parent
    while not os.path.lexists(folder) and folder != folder.parent:
        folder = folder.parent
    needed = RESERVED + _LEFT
    largest, _ = resource.getrlimit(resource.RLIMIT_FSIZE)
    if largest != resource.RLIM_INFINITY and largest < needed:
        return (
            f"a file may have {largest / 1e6:.0f} MB by a limit of this process (ulimit -f), and "
            f"the bag needs {needed / 1e6:.0f} MB"
        )
    try:
        with suppress(FileNotFoundError, NotADirectoryError):
            place.lstat()
            return f"{place} exists already"
        with ExitStack() as files:  # without names
            for _ in range(_FILES):
                file = files.enter_context(tempfile.TemporaryFile(dir=folder))
            free = shutil.disk_usage(file.fileno()).free
            if free >= needed:
                os.posix_fallocate(file.fileno(), 0, RESERVED)  # also a quota may be used up
    except OSError as error:
        return f"nothing can be written in {folder} ({file_reason(error)})"
    if free < needed:
        return f"{folder} has room for {free / 1e6:.0f} MB, and the bag needs {needed / 1e6:.0f} MB"
    return ""
