"""The tests of a tournament, and what each was worth."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from typing import Any

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import ExperimentError, SeftError
from seft_msgs_py.wire.topics import RIG_STATE
from seft_plant_sim.reference.whole_structure import (
    ReferenceResponse,
    reference_response,
)

from seft_ros.analysis.summary import summarise_briefly
from seft_ros.experiment.blocks import build_blocks
from seft_ros.experiment.ensemble import Workshop, thread_map
from seft_ros.experiment.offline import simulate
from seft_ros.ground_motion.block import GroundMotion
from seft_ros.recording.record import Record
from seft_ros.tournament.entries import Entry, Tournament
from seft_ros.tournament.workers import parallel_map

Progress = Callable[[str, int], None]


@dataclass(frozen=True)
class Run:
    """One test and its outcome.

    Attributes
    ----------
    entry : Entry
        Which test.
    summary : dict
        As `seft_ros.analysis.summary.summarise_briefly` gives it.
    obstacle : str
        Why it ran on the blocks of `seft simulate` themselves; empty: on the compiled loop.
    """

    entry: Entry
    summary: dict[str, Any]
    obstacle: str = ""

    @property
    def engine(self) -> str:
        """``compiled`` or ``plain``."""
        return "plain" if self.obstacle else "compiled"

    @property
    def stable(self) -> bool:
        """Neither tripped nor beyond all numbers."""
        return bool(self.summary["stable"])

    @property
    def nrmse(self) -> float | None:
        """Error of the displacement; None where the test was unstable or is undefined."""
        error: float | None = self.summary["displacement"]["nrmse"]
        return error if self.stable else None


def count_calculations(tournament: Tournament) -> int:
    """Count what `run_all` calculates: tests, and exact responses."""
    entries = tournament.entries()
    return len(entries) + len({entry[:2] for entry in entries})


def run_all(
    tournament: Tournament, workers: int = 1, progress: Progress | None = None
) -> list[Run]:
    """Run all tests offline; the results do not depend on the number of workers.

    Tests that the compiled loop can't run (see `obstacles`) are run by the plain blocks, which
    takes many times as long, and named so.

    Parameters
    ----------
    tournament : Tournament
        Its entries are run in their order, the compiled ones first.
    workers : int
        Number of threads for those, and of processes for the others.
    progress : callable, optional
        Called with a few words on what was calculated, and how much was so far.

    Raises
    ------
    ExperimentError
        If a test could not be calculated; names it.
    """
    entries = tournament.entries()
    experiments = [tournament.experiment_of(entry) for entry in entries]
    structures = {entry[:2]: experiments[index] for index, entry in enumerate(entries)}
    names = [str(entry) for entry in entries]
    done = 0

    def told(what: str) -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(what, done)

    references: dict[tuple[float, int], ReferenceResponse] = {}
    runs: dict[Entry, Run] = {}
    shop = Workshop()
    reasons = obstacles(tournament, shop)
    with parallel_map(min(workers, len(entries))) as map_:
        titles = [f"mass ratio {ratio:g}, rig {rig}, exact" for ratio, rig in structures]
        responses = thread_map(workers, _exact_response, titles, structures.values())
        for key, title, response in zip(structures, titles, responses, strict=True):
            references[key] = response
            told(title)

        def compiled(index: int) -> dict[str, Any]:
            with _named(names[index]):
                record = shop.run(experiments[index])
                return _brief(record, references[entries[index][:2]])

        plain = [index for index, entry in enumerate(entries) if reasons[entry[::2]]]
        quick = [index for index in range(len(entries)) if index not in set(plain)]
        # the processes begin at once, and go on beside the threads
        outcomes = map_(
            _outcome,
            [names[index] for index in plain],
            [experiments[index] for index in plain],
            [references[entries[index][:2]] for index in plain],
        )
        for index, summary in zip(quick, thread_map(workers, compiled, quick), strict=True):
            runs[entries[index]] = Run(entries[index], summary)
            told(names[index])
        for index, summary in zip(plain, outcomes, strict=True):
            runs[entries[index]] = Run(entries[index], summary, reasons[entries[index][::2]])
            told(f"{names[index]} (plain blocks)")
    return [runs[entry] for entry in entries]


def obstacles(tournament: Tournament, shop: Workshop) -> dict[tuple[float, str], str]:
    """Say why tests can't run on the compiled loop; (mass ratio, method) -> reason, or empty.

    The rigs of a tournament differ in numbers alone, so that one speaks for all.
    """
    return {
        (ratio, method): shop.obstacle(tournament.experiment_of(Entry(ratio, 0, method)))
        for ratio, method in tournament.pairs()
    }


def _exact_response(name: str, experiment: Experiment) -> ReferenceResponse:
    with _named(name):
        motion = GroundMotion.from_parameters(
            experiment["ground_motion"], experiment.axes, experiment.timebase
        )
        return reference_response(experiment, motion.samples)


def _outcome(name: str, experiment: Experiment, reference: ReferenceResponse) -> dict[str, Any]:
    with _named(name):
        record = simulate(experiment, build_blocks(experiment))
        return _brief(record, reference)


def _brief(record: Record, reference: ReferenceResponse) -> dict[str, Any]:
    return summarise_briefly(record, _first(reference, len(record.series[RIG_STATE.name].steps)))


def _first(reference: ReferenceResponse, steps: int) -> ReferenceResponse:
    """Cut a response to the steps that a test lasted."""
    parts = {field.name: getattr(reference, field.name)[:steps] for field in fields(reference)}
    return ReferenceResponse(**parts)


@contextmanager
def _named(name: str) -> Iterator[None]:
    """Say in one line what went wrong in which test."""
    try:
        yield
    except SeftError as error:
        raise type(error)(f"{name}: {error}") from None
    except Exception as error:
        raise ExperimentError(f"{name}: {type(error).__name__}: {error}") from error
