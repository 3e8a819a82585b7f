"""The bag of a running test: whether there is room for it, and how it survives its place on disk.

A bag that is deleted, moved or can't be written any more is reported at once, and what it held and
what came after is written into a whole bag at the end: an open file can be read as long as it is
open.
"""

import math
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from itertools import chain, count
from pathlib import Path

import numpy as np
from seft_msgs_py.config.parameter_table import Section
from seft_msgs_py.errors import ExperimentError, SeftError
from seft_msgs_py.wire.topics import RIG_STATE, TARGET, VALVE_COMMAND, Timebase, Topic
from seft_msgs_py.wire.trajectory import TrajectoryCodec

from seft_ros.bags.bag_storage import RESERVED, SPARE, Found, file_reason, source_of
from seft_ros.bags.bag_writer import FLUSH_PERIOD, BagWriter
from seft_ros.reference_force.reference_force_parameters import reference_force_topic

MOST_IN_MEMORY = 1 << 30  # bytes, of a test that goes on without its bag
SAVED = "_saved"
"""End of the name of a bag that could not be saved in its own place."""
_FRAME = 47  # bytes of an mcap file for each message beside it: its record's head, and the index


class LastingBag:
    """Takes all messages of a test, and ends as a whole bag, if there is any place for it.

    Parameters
    ----------
    place : Path
        Folder to be made for the bag. Where none can be made, messages are kept in memory.
    storage : str
        ``mcap`` or ``sqlite3``.

    Attributes
    ----------
    trouble : str
        How the bag was lost; empty as long as it is in place.
    is_full : bool
        Whether the messages of a lost bag have used up the memory that they may take.
    """

    def __init__(self, place: Path, storage: str) -> None:
        self.trouble = ""
        self.is_full = False
        self._place, self._storage = place, storage
        self._writer: BagWriter | None = None
        self._writes = True  # else messages are kept in memory
        self._kept: list[Found] = []
        self._kept_bytes = 0
        self._polled_at = time.monotonic()
        try:
            self._writer = BagWriter(place, storage)
        except SeftError as error:
            self._lose(str(error))

    def write(self, topic: Topic, raw: bytes, time_ns: int) -> None:
        """Take a message, with the wall-clock time in ns at which it was received."""
        if self._writer is not None and self._writes:
            try:
                self._writer.write(topic, raw, time_ns)
            except ExperimentError as error:  # which has kept the message
                self._lose(str(error))
        else:
            self._kept.append((source_of(topic), time_ns, raw))
            self._kept_bytes += len(raw)
            self.is_full = self._kept_bytes > MOST_IN_MEMORY

    def poll(self) -> None:
        """Flush if due, and check whether the bag is still in its place."""
        now = time.monotonic()
        if self._writer is None or now - self._polled_at < FLUSH_PERIOD:
            return
        self._polled_at = now
        if self._writes:
            try:
                self._writer.flush()
            except ExperimentError as error:
                self._lose(str(error))
        self.trouble = self.trouble or self._writer.displaced() or self._writer.running_out

    def close(self) -> Path:
        """End the bag; give its folder, which is another one if the bag was lost.

        Raises
        ------
        ExperimentError
            If there is no place for it, here or in the folder for temporary files; to be called
            again when there may be one.
        """
        writer = self._writer
        if writer is not None:
            try:
                if self._writes:
                    writer.close()
            except ExperimentError as error:
                self._lose(str(error))
            if writer.is_whole and not self._kept:
                return writer.path
        why = ""
        for place in self._places():
            try:
                self._build(place)
            except (SeftError, OSError) as error:
                why = why or f"{error}"
            else:
                return place
        raise ExperimentError(f"the bag can't be saved: {why}")

    def _lose(self, why: str) -> None:
        self._writes = False
        place = self._writer.displaced() if self._writer is not None else ""
        self.trouble = self.trouble or place or why

    def _places(self) -> Iterator[Path]:
        """Give free places: where the bag was, beside it, among temporary files."""
        for folder in (self._place.parent, Path(tempfile.gettempdir())):
            names = (f"{self._place.name}{SAVED}{k if k > 1 else ''}" for k in count(1))
            if folder == self._place.parent and not self._place.exists():
                yield self._place
            else:
                yield next(place for name in names if not (place := folder / name).exists())

    def _build(self, place: Path) -> None:
        """Write a whole bag of all messages; leave nothing if that fails."""
        bag = BagWriter(place, self._storage)
        written = self._writer.messages() if self._writer is not None else ()
        try:
            with bag:
                for found in chain(written, self._kept):
                    bag.add(found)
        except BaseException:
            shutil.rmtree(place, ignore_errors=True)
            raise


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


def obstacle(place: Path, expected: int = 0) -> str:
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
    # as much as the bag reserves for its end must stay free beside that, or the bag ends at once
    needed = 2 * RESERVED + SPARE + expected
    if free < needed:
        return f"{folder} has room for {free / 1e6:.0f} MB, and the bag needs {needed / 1e6:.0f} MB"
    return ""
