"""The tests of a study are run, here or on a cluster."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import lru_cache
from itertools import repeat
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp
from typing import Any

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import ExperimentError, SeftError
from seft_plant_sim.whole_structure import ReferenceResponse

from seft_ros.analysis.summary import summarise_briefly
from seft_ros.bags.record import Record
from seft_ros.ground_motion.ground_motion_block import FILES
from seft_ros.ground_motion.record_file import files_of
from seft_ros.study.finished_tests import FinishedTests, TestOutcome
from seft_ros.study.study_plan import StudyPlan, StudyTest
from seft_ros.study.workers import parallel_map
from seft_ros.test_run.compiled_loop import build_blocks
from seft_ros.test_run.offline import BlockCache, simulate_test

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
    plan: StudyPlan,
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
    plan : StudyPlan
        Whose `StudyPlan.tests` are run.
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
    tests = plan.tests()
    known = finished.read() if finished else {}
    found = {test: known[test] for test in tests if test in known}
    if found:
        progress(f"{len(found)} tests were finished before", len(found))
    left = [test for test in tests if test not in found]
    experiments = map(plan.experiment_of, left)
    carried = plan.records() if scheduler else {}
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
                if (files := files_of(experiment["ground_motion"][name]))
            }
            experiment = Experiment(experiment.sections | {"ground_motion": section})
        reference, why = _CACHE.reference(experiment), _CACHE.why_not_compiled(experiment)
        if why:  # what learns begins with blocks of its own
            record = simulate_test(experiment, build_blocks(experiment))
        else:
            record = _CACHE.run(experiment)
        return _brief(record, reference), why
    except SeftError as error:
        raise type(error)(f"{test}: {error}") from None
    except Exception as error:
        raise ExperimentError(f"{test}: {type(error).__name__}: {error}") from error


def _brief(record: Record, reference: ReferenceResponse) -> dict[str, Any]:
    """Summarise a test against the reference response, cut to the steps that it lasted."""
    steps = len(record.states.steps)
    parts = {field.name: getattr(reference, field.name)[:steps] for field in fields(reference)}
    return summarise_briefly(record, ReferenceResponse(**parts))


@lru_cache(maxsize=64)
def _at_hand(name: str, content: bytes) -> str:
    """Write a ground motion that came from another machine into a file."""
    file = Path(mkdtemp(dir=_folder().name), name)
    file.write_bytes(content)
    return str(file)


@lru_cache
def _folder() -> TemporaryDirectory[str]:
    return TemporaryDirectory(prefix="seft-")
