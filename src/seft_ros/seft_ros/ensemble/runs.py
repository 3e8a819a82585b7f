"""Tests are run, here or on a cluster; what is finished is kept until all of them are."""

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import lru_cache
from itertools import repeat
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp
from typing import Any

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import ExperimentError, InputError, SeftError
from seft_msgs_py.wire.topics import RIG_STATE
from seft_plant_sim.whole_structure import ReferenceResponse

from seft_ros.analysis.summary import summarise_briefly
from seft_ros.bags.record import Record
from seft_ros.ensemble.workers import parallel_map, software
from seft_ros.test_run.compiled_loop import build_blocks
from seft_ros.test_run.offline import Workshop, simulate

Progress = Callable[[str, int], None]
Test = tuple[Any, Experiment]
"""Entry, whose text names the test, and experiment."""
Outcome = tuple[dict[str, Any], str]
"""Summary and obstacle of a `Run`."""

_SHOP = Workshop()


@dataclass(frozen=True)
class Run:
    """One test and its outcome.

    Attributes
    ----------
    entry : object
        Which test; its text names it.
    summary : dict
        As `seft_ros.analysis.summary.summarise_briefly` gives it.
    obstacle : str
        Why it ran on the uncompiled blocks of `seft simulate`; empty: on the compiled loop.
    """

    entry: Any
    summary: dict[str, Any]
    obstacle: str = ""

    @property
    def engine(self) -> str:
        """``compiled`` or ``plain``."""
        return "plain" if self.obstacle else "compiled"

    @property
    def stable(self) -> bool:
        """Whether it neither tripped nor has samples that are not finite."""
        return bool(self.summary["stable"])

    @property
    def nrmse(self) -> float | None:
        """Error of the displacement; None where the test was unstable or it is undefined."""
        error: float | None = self.summary["displacement"]["nrmse"]
        return error if self.stable else None


@dataclass(frozen=True)
class Place:
    """Where tests are run.

    Attributes
    ----------
    workers : int
        Processes on this machine; 1: this one alone.
    scheduler : str
        Address of a Dask scheduler, whose workers are taken instead; empty: none.
    keep : Path or None
        Folder in which finished tests are kept until all are; None: they are not.
    """

    workers: int = 1
    scheduler: str = ""
    keep: Path | None = None


def run_tests(
    tests: Sequence[Test], place: Place, progress: Progress | None = None, name: str = "tests"
) -> list[Run]:
    """Run tests offline; the results do not depend on where.

    A test that the compiled loop can't run (`Workshop.obstacle`) is run by the uncompiled blocks,
    which takes many times as long.

    Parameters
    ----------
    tests : sequence
        Entries and experiments.
    place : Place
        Where; tests with the same inputs and software that were finished there and interrupted
        before the end are not run again.
    progress : callable, optional
        Called with what was run, and how many tests are done.
    name : str
        Of the file of finished tests, before the digest of the inputs.

    Raises
    ------
    ExperimentError
        If a test could not be calculated; names it.
    """
    records = _records(experiment for _, experiment in tests)
    file = place.keep and place.keep / f"{name}-{_digest(tests, records)}.jsonl"
    kept = Kept(file)
    found = kept.read()
    if progress is not None and found:
        progress(f"{len(found)} tests were finished before", len(found))
    left = [index for index in range(len(tests)) if index not in found]
    titles, experiments = [str(tests[i][0]) for i in left], [tests[i][1] for i in left]
    carried = records if place.scheduler else {}
    with parallel_map(max(1, min(place.workers, len(left))), place.scheduler) as map_:
        for position, outcome in map_(_run, titles, experiments, repeat(carried, len(left))):
            kept.add(left[position], outcome)
            found[left[position]] = outcome
            if progress is not None:
                how = " (uncompiled)" if outcome[1] else ""
                progress(f"{titles[position]}{how}", len(found))
    kept.remove()
    return [Run(entry, *found[index]) for index, (entry, _) in enumerate(tests)]


def _run(title: str, experiment: Experiment, carried: Mapping[str, bytes]) -> Outcome:
    """Run a test; an error says in one line which it is of."""
    try:
        if carried and (file := experiment["ground_motion"]["file"]):
            local = _at_hand(Path(file).name, carried[file])
            section = experiment["ground_motion"] | {"file": local}
            experiment = Experiment(experiment.sections | {"ground_motion": section})
        reference, obstacle = _SHOP.reference(experiment), _SHOP.obstacle(experiment)
        if obstacle:  # what learns begins with blocks of its own
            record = simulate(experiment, build_blocks(experiment))
        else:
            record = _SHOP.run(experiment)
        return _brief(record, reference), obstacle
    except SeftError as error:
        raise type(error)(f"{title}: {error}") from None
    except Exception as error:
        raise ExperimentError(f"{title}: {type(error).__name__}: {error}") from error


def _brief(record: Record, reference: ReferenceResponse) -> dict[str, Any]:
    """Summarise a test against the reference response, cut to the steps that it lasted."""
    steps = len(record.series[RIG_STATE.name].steps)
    parts = {field.name: getattr(reference, field.name)[:steps] for field in fields(reference)}
    return summarise_briefly(record, ReferenceResponse(**parts))


def _records(experiments: Iterable[Experiment]) -> dict[str, bytes]:
    """Read the files of ground motions."""
    files = {str(experiment["ground_motion"]["file"]) for experiment in experiments} - {""}
    return {file: Path(file).read_bytes() for file in sorted(files)}


@lru_cache(maxsize=64)
def _at_hand(name: str, content: bytes) -> str:
    """Write a ground motion that came from another machine into a file."""
    file = Path(mkdtemp(dir=_folder().name), name)
    file.write_bytes(content)
    return str(file)


@lru_cache
def _folder() -> TemporaryDirectory[str]:
    return TemporaryDirectory(prefix="seft-")


def _digest(tests: Sequence[Test], records: Mapping[str, bytes]) -> str:
    """Digest what the results depend on: parameters, ground motions, software."""
    texts = hashlib.sha256(software().encode())
    for entry, experiment in tests:
        texts.update(json.dumps([str(entry), experiment.sections], sort_keys=True).encode())
    for content in records.values():
        texts.update(hashlib.sha256(content).digest())
    return texts.hexdigest()[:12]


class Kept:
    """Finished tests in a file, a line of JSON for each; without a file none are kept."""

    def __init__(self, file: Path | None) -> None:
        self._file = file

    def read(self) -> dict[int, Outcome]:
        """Read the tests that are finished, and cut off a line that was not written to its end."""
        if self._file is None or not self._file.exists():
            return {}
        with self._told():
            whole, end, _ = self._file.read_bytes().rpartition(b"\n")
            self._file.write_bytes(whole + end)
        try:
            lines = [json.loads(line) for line in whole.splitlines()]
            return {int(index): (dict(summary), str(why)) for index, summary, why in lines}
        except (ValueError, TypeError):
            raise InputError(f"{self._file}: holds no finished tests; remove it") from None

    def add(self, index: int, outcome: Outcome) -> None:
        """Add a test."""
        if self._file is not None:
            with self._told(), self._file.open("a") as lines:
                lines.write(json.dumps([index, *outcome]) + "\n")

    def remove(self) -> None:
        """Remove the file."""
        if self._file is not None:
            with self._told():
                self._file.unlink(missing_ok=True)

    @contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise InputError(
                f"{self._file}: finished tests can't be kept there ({error.strerror}); start in a "
                "folder that can be written to"
            ) from None
