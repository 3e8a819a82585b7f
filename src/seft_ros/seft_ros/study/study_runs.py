"""The tests of a study are run, here or on a cluster, and kept until the page is written.

Here it is Python's own pool of processes: it starts in two thirds of the time of Dask's local
cluster, in half the processes, and needs no Dask.
"""

import hashlib
import json
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache, partial
from importlib.metadata import version
from itertools import repeat
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp
from typing import Any

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import ExperimentError, InputError, SeftError
from seft_plant_sim.compiled import code_folder

from seft_ros.analysis.summary import summarise_briefly
from seft_ros.ground_motion.ground_motion_block import FILES
from seft_ros.ground_motion.record_file import files_of
from seft_ros.study.drawn_tests import StudyDesign, StudyTest
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.offline import BlockCache, simulate_test

Map = Callable[..., Iterator[tuple[int, Any]]]
"""A `map` over functions of modules, whose arguments and results can be pickled.

It gives the place and the result of each call as soon as there is one.
"""
_CONNECT_TIME = 5.0  # s


@contextmanager
def parallel_map(workers: int, scheduler: str = "") -> Iterator[Map]:
    """Give a `map` that calculates on several processes.

    A worker is a fresh interpreter (spawn) with one thread for linear algebra, which
    `seft_msgs_py` sets. When the block is left early, the workers end.

    Parameters
    ----------
    workers : int
        Number of processes on this machine; 1: this one alone.
    scheduler : str
        Address of a Dask scheduler, whose workers are taken instead.

    Raises
    ------
    ExperimentError
        If a worker dies.
    InputError
        If there is no scheduler, or its workers have other software than this process.
    """
    if scheduler:
        with _cluster(scheduler) as executor:
            yield partial(_spread, executor)
    elif workers == 1:
        yield lambda function, *arguments: enumerate(map(function, *arguments))
    else:
        with _pool(workers) as executor:
            yield partial(_spread, executor)


@contextmanager
def _pool(workers: int) -> Iterator[Executor]:
    others, context = set(multiprocessing.active_children()), multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, context, _end_with_parent)
    try:
        yield pool
    except BaseException as error:
        for worker in set(multiprocessing.active_children()) - others:
            worker.kill()
        if isinstance(error, BrokenProcessPool):
            raise ExperimentError(
                "a worker died, maybe for want of memory; the same command with fewer --workers "
                "continues"
            ) from None
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _end_with_parent() -> None:
    """End this worker when its parent has ended, for whatever reason."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _cluster(address: str) -> Iterator[Executor]:
    try:
        from distributed import Client, KilledWorker
    except ImportError:
        raise InputError(
            "--scheduler: Dask is not installed; install it with: pip install 'seft_ros[dask]'"
        ) from None
    try:
        client = Client(address, timeout=_CONNECT_TIME)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"--scheduler {address}: no Dask scheduler answers there ({error}); start one with: "
            "dask scheduler"
        ) from None
    try:
        with client:
            yield client.get_executor(pure=False)
    except KilledWorker:
        raise ExperimentError(
            f"--scheduler {address}: a calculation killed worker after worker, maybe for want of "
            "memory; start workers with more of it"
        ) from None
    except CancelledError:
        raise ExperimentError(f"--scheduler {address}: the scheduler has ended") from None
    except ModuleNotFoundError as error:
        raise InputError(
            f"--scheduler {address}: a worker lacks {error.name}; install seft there"
        ) from None


def _spread(
    executor: Executor, function: Callable[..., Any], *arguments: Any
) -> Iterator[tuple[int, Any]]:
    """Begin to calculate, see `Map`."""
    # what is started here inherits the mask: Ctrl-C is for the parent alone to deal with
    before, own = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}), software()
    try:
        calls = enumerate(zip(*arguments, strict=False))
        places = {
            executor.submit(_calculate_alike, own, function, *each): place for place, each in calls
        }
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    return _results(places)


def _results(places: dict[Future[Any], int]) -> Iterator[tuple[int, Any]]:
    for future in as_completed(list(places)):
        yield places.pop(future), future.result()


def _calculate_alike(wanted: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """Calculate where the software is that of the process that asks, so that bits are the same."""
    if (own := software()) != wanted:
        raise InputError(
            f"a worker of the cluster has other software ({own}) than this machine ({wanted}); "
            "install the same there"
        )
    return function(*arguments)


def software() -> str:
    """Name what results depend on beside their inputs: the text of the packages, and libraries."""
    text = code_folder(Path(__file__).parents[1]).name  # numba's version is in it
    return f"{text}, numpy {version('numpy')}, scipy {version('scipy')}"


TestOutcome = tuple[dict[str, Any], str]
"""Summary, and why it was not compiled, of a `seft_ros.study.study_runs.Run`."""


class FinishedTests:
    """A line of JSON for each test, in a file of this folder for equal inputs and software.

    More tests, methods or mass ratios have the same file.
    """

    def __init__(self, design: StudyDesign, folder: Path) -> None:
        self._file = folder / f"study-{_digest(design)}.jsonl"

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


def _digest(design: StudyDesign) -> str:
    """Digest what the result of a test depends on beside its mass ratio, method and number."""
    drawn = design.drawn
    inputs = [software(), design.experiment.sections, drawn.seed, drawn.spread, drawn.motions]
    contents = [hashlib.sha256(content).hexdigest() for content in design.records().values()]
    text = json.dumps([*inputs, contents], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


_CACHE = BlockCache()


@dataclass(frozen=True)
class Run:
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
        for position, outcome in map_(_run, left, experiments, repeat(carried, len(left))):
            if finished:
                finished.add(left[position], outcome)
            found[left[position]] = outcome
            how = " (uncompiled)" if outcome[1] else ""
            progress(f"{left[position]}{how}", len(found))
    return [Run(test, *found[test]) for test in tests]


def _run(test: StudyTest, experiment: Experiment, carried: Mapping[str, bytes]) -> TestOutcome:
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
        steps = len(recording.states.steps)
        return summarise_briefly(recording, reference.first(steps)), why
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
