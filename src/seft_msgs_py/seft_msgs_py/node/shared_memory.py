"""Whether a ROS process can start here at all, told before rclpy is imported."""

import errno
import os
import tempfile
from pathlib import Path

from seft_msgs_py.errors import InputError

FOLDER = Path("/dev/shm")
TRACERS = "lttng-ust-wait-*"


def check_shared_memory(folder: Path = FOLDER) -> None:
    """See that there is a page of shared memory for the tracer that rclpy brings along (LTTng).

    It maps a file there, and where no memory is behind it, the kernel ends the process (SIGBUS).
    Our messages need none.

    Raises
    ------
    InputError
        If there is none.
    """
    files = list(folder.glob(TRACERS))
    if (files and all(file.stat().st_blocks for file in files)) or not folder.is_dir():
        return
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            os.posix_fallocate(file.fileno(), 0, 2 * os.sysconf("SC_PAGESIZE"))
    except OSError as error:
        if error.errno == errno.ENOSPC:
            raise InputError(
                f"{folder} is full, and no ROS process can start: remove what nobody uses there"
            ) from None
