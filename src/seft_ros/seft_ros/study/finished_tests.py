"""The tests of a study that are finished, kept in a file until all are."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from seft_msgs_py.errors import InputError

from seft_ros.study.study_plan import StudyTest

Outcome = tuple[dict[str, Any], str]
"""Summary and obstacle of a `seft_ros.study.study_runs.Run`."""


class FinishedTests:
    """A line of JSON for each test; without a file none are kept."""

    def __init__(self, file: Path | None) -> None:
        self._file = file

    def read(self) -> dict[StudyTest, Outcome]:
        """Read the tests, and cut off a line that was not written to its end."""
        if self._file is None or not self._file.exists():
            return {}
        with self._reported():
            whole, end, _ = self._file.read_bytes().rpartition(b"\n")
            self._file.write_bytes(whole + end)
        try:
            lines = [json.loads(line) for line in whole.splitlines()]
            return {StudyTest(*test): (dict(summary), str(why)) for test, summary, why in lines}
        except (ValueError, TypeError):
            raise InputError(f"{self._file}: holds no finished tests; remove it") from None

    def add(self, test: StudyTest, outcome: Outcome) -> None:
        """Add a test."""
        if self._file is not None:
            with self._reported(), self._file.open("a") as lines:
                lines.write(json.dumps([test, *outcome]) + "\n")

    def remove(self) -> None:
        """Remove the file."""
        if self._file is not None:
            with self._reported():
                self._file.unlink(missing_ok=True)

    @contextmanager
    def _reported(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise InputError(
                f"{self._file}: finished tests can't be kept there ({error.strerror}); start in a "
                "folder that can be written to"
            ) from None
