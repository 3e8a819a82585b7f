"""The place of a bag that is to be recorded: whether one can be made there, and has room."""

import math
import os
import shutil
import tempfile
from pathlib import Path

import numpy as np
from seft_msgs_py.config.parameter_table import Section
from seft_msgs_py.wire.topics import RIG_STATE, TARGET, VALVE_COMMAND, Timebase
from seft_msgs_py.wire.trajectory import TrajectoryCodec

from seft_ros.bags.bag_writer import RESERVED, file_reason
from seft_ros.reference_force.reference_force_parameters import reference_force_topic

_LEFT = 4 << 20  # bytes that must stay free beside the bag, for other files of a test
_FRAME = 47  # bytes of an mcap file for each message beside it: its record's head, and the index


def expected_size(force: Section, axes: tuple[str, ...], timebase: Timebase, steps: int) -> int:
    """Size of the samples of a test in its bag, bytes.

    Parameters
    ----------
    force : dict
        Parameters of reference_force; an unknown one counts as absent.
    axes : tuple of str
        The test's.
    timebase : Timebase
        The test's.
    steps : int
        Samples of the test.
    """
    topic, points = reference_force_topic(force), 1 + max(0, force.get("loop_delay", 0))
    if topic == TARGET:
        points += math.ceil(force.get("compensation.horizon", 0.0) * timebase.rate)
    size = 0
    for each, number in ((RIG_STATE, 1), (topic, points), (VALVE_COMMAND, 1)):
        codec = TrajectoryCodec(each, axes, timebase)
        values = np.zeros((number, len(each.quantities), len(axes)))
        size += len(codec.encode_points(0, values)) + _FRAME
    return steps * size


def why_not_writable(place: Path, expected: int = 0) -> str:
    """Say why no bag can be made at a place; empty if it can.

    Parameters
    ----------
    place : Path
        The bag's folder, to be made.
    expected : int
        Size of what will be written, bytes.
    """
    try:
        place.lstat()
        return f"{place} exists already"
    except (FileNotFoundError, NotADirectoryError):
        pass
    except OSError as error:
        return f"{place} can't be made ({file_reason(error)})"
    folder = place.absolute().parent
    while not os.path.lexists(folder) and folder != folder.parent:
        folder = folder.parent
    try:
        with tempfile.TemporaryFile(dir=folder) as file:  # without a name
            free = shutil.disk_usage(file.fileno()).free
    except OSError as error:
        return f"nothing can be written in {folder} ({file_reason(error)})"
    needed = RESERVED + _LEFT + expected
    if free < needed:
        return f"{folder} has room for {free / 1e6:.0f} MB, and the bag needs {needed / 1e6:.0f} MB"
    return ""
