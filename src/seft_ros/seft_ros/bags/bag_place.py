"""The place of a bag that is to be recorded: whether one can be made there, and has room."""

import os
import shutil
import tempfile
from contextlib import suppress
from pathlib import Path

from seft_ros.bags.bag_writer import RESERVED, file_reason

_LEFT = 4 << 20  # bytes that must stay free beside the bag, for other files of a test


def why_not_writable(place: Path) -> str:
    """Say why no bag can be made in a folder that is to be made; empty if it can."""
    folder = place.absolute().parent
    while not os.path.lexists(folder) and folder != folder.parent:
        folder = folder.parent
    try:
        with suppress(FileNotFoundError, NotADirectoryError):
            place.lstat()
            return f"{place} exists already"
        with tempfile.TemporaryFile(dir=folder) as file:  # without a name
            free = shutil.disk_usage(file.fileno()).free
    except OSError as error:
        return f"nothing can be written in {folder} ({file_reason(error)})"
    needed = RESERVED + _LEFT
    if free < needed:
        return f"{folder} has room for {free / 1e6:.0f} MB, and the bag needs {needed / 1e6:.0f} MB"
    return ""
