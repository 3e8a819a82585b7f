"""The bag of a test under way, which loses nothing when its place on disk is lost.

A bag that is deleted, moved or can't be written on is told at once, and what it held and what came
after is put into a whole bag at the end: the file that was open can be read as long as it is open.
"""

import shutil
import tempfile
import time
from collections.abc import Iterator
from itertools import count
from pathlib import Path

from seft_msgs_py.errors import ExperimentError, SeftError
from seft_msgs_py.wire.topics import Topic

from seft_ros.recording.bag_writer import FLUSH_PERIOD, BagWriter, Message

MOST_IN_MEMORY = 1 << 30  # bytes, of a test that goes on without its bag
SAVED = "_saved"
"""End of the name of a bag that could not be made where it was to be."""


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
        What has become of the bag; empty as long as all is well.
    is_full : bool
        Whether memory is used up that messages of a lost bag may take.
    """

    def __init__(self, place: Path, storage: str) -> None:
        self.trouble = ""
        self.is_full = False
        self._place, self._storage = place, storage
        self._writer: BagWriter | None = None
        self._writes = True  # else what comes is kept in memory
        self._kept: list[Message] = []
        self._kept_bytes = 0
        self._looked_at = time.monotonic()
        try:
            self._writer = BagWriter(place, storage)
        except SeftError as error:
            self._lose(str(error))

    def write(self, topic: Topic, raw: bytes, time_ns: int) -> None:
        """Take a message, with the wall-clock time in ns at which it was received."""
        if self._writer is not None and self._writes:
            try:
                self._writer.write(topic, raw, time_ns)
            except ExperimentError as error:  # the message is in it, or among its unwritten ones
                self._lose(str(error))
        else:
            self._kept.append((topic, raw, time_ns))
            self._kept_bytes += len(raw)
            self.is_full = self._kept_bytes > MOST_IN_MEMORY

    def look(self) -> None:
        """Write what is due, and see whether the bag is still in its place."""
        now = time.monotonic()
        if self._writer is None or now - self._looked_at < FLUSH_PERIOD:
            return
        self._looked_at = now
        if self._writes:
            try:
                self._writer.flush()
            except ExperimentError as error:
                self._lose(str(error))
        self.trouble = self.trouble or self._writer.displaced() or self._writer.running_out

    def close(self) -> Path:
        """End the bag; give its folder, which is another where the first could not be kept.

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
        """Places that are free: where the bag was, beside it, among temporary files."""
        for folder in (self._place.parent, Path(tempfile.gettempdir())):
            names = (f"{self._place.name}{SAVED}{k if k > 1 else ''}" for k in count(1))
            if folder == self._place.parent and not self._place.exists():
                yield self._place
            else:
                yield next(place for name in names if not (place := folder / name).exists())

    def _build(self, place: Path) -> None:
        """Write a whole bag of all that there is; leave nothing where that fails."""
        bag = BagWriter(place, self._storage)
        try:
            with bag:
                if self._writer is not None:
                    for found in self._writer.written():
                        bag.copy(found)
                    for message in self._writer.unwritten():
                        bag.write(*message)
                for message in self._kept:
                    bag.write(*message)
        except BaseException:
            shutil.rmtree(place, ignore_errors=True)
            raise
