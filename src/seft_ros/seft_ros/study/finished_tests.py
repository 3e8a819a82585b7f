"""The tests of a study that are finished, kept in a file until its page is written."""

import hashlib
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from seft_msgs_py.errors import InputError

from seft_ros.study.study_plan import StudyPlan, StudyTest
from seft_ros.study.workers import software

TestOutcome = tuple[dict[str, Any], str]
"""Summary, and why it was not compiled, of a `seft_ros.study.study_runs.Run`."""


class FinishedTests:
    """A line of JSON for each test, in a file of this folder for equal inputs and software.

    More tests, methods or mass ratios have the same file.
    """

    def __init__(self, plan: StudyPlan, folder: Path) -> None:
        self._file = folder / f"study-{_digest(plan)}.jsonl"

    def read(self) -> dict[StudyTest, TestOutcome]:
        """Read the tests, and cut off a line that was not written to its end."""
        if not self._file.exists():
            return {}
        with self._reported():
            whole, end, _ = self._file.read_bytes().rpartition(b"\n")
            self._file.write_bytes(whole + end)
        try:
            lines = [json.loads(line) for line in whole.splitlines()]
            return {StudyTest(*test): (dict(summary), str(why)) for test, summary, why in lines}
        except (ValueError, TypeError):
            raise InputError(f"{self._file}: holds no finished tests; remove it") from None

    def add(self, test: StudyTest, outcome: TestOutcome) -> None:
        """Add a test."""
        with self._reported(), self._file.open("a") as lines:
            lines.write(json.dumps([test, *outcome]) + "\n")

    def remove(self) -> None:
        """Remove the file."""
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


def _digest(plan: StudyPlan) -> str:
    """Digest what the result of a test depends on beside its mass ratio, method and number."""
    drawn = plan.drawn
    inputs = [software(), plan.experiment.sections, drawn.seed, drawn.spread, drawn.motions]
    contents = [hashlib.sha256(content).hexdigest() for content in plan.records().values()]
    text = json.dumps([*inputs, contents], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]
