"""The tests of a study are run, here or on a cluster, and kept until the page is written."""

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from itertools import repeat
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp
from typing import Any, NamedTuple

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import ExperimentError, InputError, SeftError

from seft_ros.analysis.summary import summarise_briefly
from seft_ros.ground_motion.ground_motion_block import FILES
from seft_ros.ground_motion.record_file import files_of
from seft_ros.study.drawn_tests import StudyDesign, StudyTest
from seft_ros.study.workers import parallel_map, software
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.offline import BlockCache, simulate_test


class Run(NamedTuple):
    """One test and its outcome.

    Attributes
    ----------
    test : StudyTest
        Which.
    summary : dict
        As `seft_ros.analysis.summary.summarise_briefly` gives it.
    why_not_compiled : str
        Why it ran on the uncompiled blocks of `seft simulate`; empty: on the compiled loop.
    """

    test: StudyTest
    summary: dict[str, Any]
    why_not_compiled: str = ""


class FinishedTests:
    """A line of JSON for each test, in a file of this folder for equal inputs and software.

    More tests, methods or mass ratios have the same file.
    """

    def __init__(self, design: StudyDesign, folder: Path) -> None:
        self._file = folder / f"study-{_digest(design)}.jsonl"

    def read(self) -> dict[StudyTest, Run]:
        """Read the tests, and cut off a line that was not written to its end."""
        if not self._file.exists():
            return {}
        with self._reported():
            whole, end, _ = self._file.read_bytes().rpartition(b"\n")
            self._file.write_bytes(whole + end)
        try:
            lines = map(json.loads, whole.splitlines())
            runs = [Run(StudyTest(*test), dict(summary), str(why)) for test, summary, why in lines]
            return {run.test: run for run in runs}
        except (ValueError, TypeError):
            raise InputError(f"{self._file}: holds no finished tests; remove it") from None

    def add(self, run: Run) -> None:
        """Add a test."""
        with self._reported(), self._file.open("a") as lines:
            lines.write(json.dumps(run) + "\n")

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


def _digest(design: StudyDesign) -> str:
    """Digest what the result of a test depends on beside its mass ratio, method and number."""
    drawn = design.drawn
    inputs = [software(), design.experiment.sections, drawn.seed, drawn.spread, drawn.motions]
    contents = [hashlib.sha256(content).hexdigest() for content in design.records().values()]
    text = json.dumps([*inputs, contents], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


_CACHE = BlockCache()


def run_study(
    design: StudyDesign,
    progress: Callable[[str, int], None] = lambda *_: None,
    *,
    workers: int = 1,
    scheduler: str = "",
    finished: FinishedTests | None = None,
) -> list[Run]:
    """Run the tests of a study offline; the results do not depend on where.

    A test that the compiled loop can't run (`BlockCache.why_not_compiled`) is run by the uncompiled
    blocks, which takes many times as long.

    Parameters
    ----------
    design : StudyDesign
        Whose `StudyDesign.tests` are run.
    progress : callable, optional
        Called with what was run, and how many tests are done.
    workers, scheduler : int, str
        See `parallel_map`.
    finished : FinishedTests, optional
        Tests that are not run again, and to which those that are run are added.

    Raises
    ------
    ExperimentError
        If a test could not be calculated; names it.
    """
    tests = design.tests()
    known = finished.read() if finished else {}
    found = {test: known[test] for test in tests if test in known}
    if found:
        progress(f"{len(found)} tests were finished before", len(found))
    left = [test for test in tests if test not in found]
    experiments = map(design.experiment_of, left)
    carried = design.records() if scheduler else {}
    with parallel_map(max(1, min(workers, len(left))), scheduler) as map_:
        for _, run in map_(_run, left, experiments, repeat(carried, len(left))):
            if finished:
                finished.add(run)
            found[run.test] = run
            how = " (uncompiled)" if run.why_not_compiled else ""
            progress(f"{run.test}{how}", len(found))
    return [found[test] for test in tests]


def _run(test: StudyTest, experiment: Experiment, carried: Mapping[str, bytes]) -> Run:
    """Run a test; an error says in one line which it is of."""
    try:
        if carried:
            section = experiment["ground_motion"] | {
                name: [_at_hand(Path(file).name, carried[file]) for file in files]
                for name in FILES
                if (files := files_of(experiment["ground_motion"][name], experiment.axes))
            }
            experiment = Experiment(experiment.sections | {"ground_motion": section})
        reference, why = _CACHE.reference(experiment), _CACHE.why_not_compiled(experiment)
        if why:  # what learns begins with blocks of its own
            recording = simulate_test(experiment, build_blocks(experiment))
        else:
            recording = _CACHE.run(experiment)
        summary = summarise_briefly(recording, reference.first(len(recording.states.steps)))
        return Run(test, summary, why)
    except SeftError as error:
        raise type(error)(f"{test}: {error}") from None
    except Exception as error:
        raise ExperimentError(f"{test}: {type(error).__name__}: {error}") from error


@lru_cache(maxsize=64)
def _at_hand(name: str, content: bytes) -> str:
    """Write a ground motion that came from another machine into a file."""
    file = Path(mkdtemp(dir=_folder().name), name)
    file.write_bytes(content)
    return str(file)


@lru_cache
def _folder() -> TemporaryDirectory[str]:
    return TemporaryDirectory(prefix="seft-")
