"""The tests of a tournament: what each was worth, and what a step of it costs."""

import timeit
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from statistics import median
from typing import Any

import numpy as np
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import ExperimentError, SeftError
from seft_msgs_py.wire.topics import RIG_STATE
from seft_plant_sim.reference.whole_structure import (
    ReferenceResponse,
    reference_response,
)

from seft_ros.analysis.summary import summarise_briefly
from seft_ros.bags.record import Record
from seft_ros.ground_motion.ground_motion_block import GroundMotion
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.offline import Workshop, simulate, thread_map
from seft_ros.tournament.entries import Entry, Tournament
from seft_ros.tournament.workers import parallel_map

Progress = Callable[[str, int], None]

_COST_STEPS, _COST_REPEATS = 500, 7


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
    experiments = {entry: tournament.experiment_of(entry) for entry in entries}
    structures = {entry[:2]: experiment for entry, experiment in experiments.items()}
    runs: dict[Entry, Run] = {}
    references: dict[tuple[float, int], ReferenceResponse] = {}
    shop = Workshop()
    reasons = obstacles(tournament, shop)

    def told(what: str) -> None:
        if progress is not None:
            progress(what, len(references) + len(runs))

    def compiled(entry: Entry) -> dict[str, Any]:
        with _named(str(entry)):
            return _brief(shop.run(experiments[entry]), references[entry[:2]])

    with parallel_map(min(workers, len(entries))) as map_:
        titles = [f"mass ratio {ratio:g}, rig {rig}, exact" for ratio, rig in structures]
        responses = thread_map(workers, _exact_response, titles, structures.values())
        for key, title, response in zip(structures, titles, responses, strict=True):
            references[key] = response
            told(title)
        plain = [entry for entry in entries if reasons[entry[::2]]]
        quick = [entry for entry in entries if not reasons[entry[::2]]]
        # the processes begin at once, and go on beside the threads
        outcomes = map_(
            _outcome,
            [str(entry) for entry in plain],
            [experiments[entry] for entry in plain],
            [references[entry[:2]] for entry in plain],
        )
        summaries = thread_map(workers, compiled, quick)
        for own, found, how in ((quick, summaries, ""), (plain, outcomes, " (plain blocks)")):
            for entry, summary in zip(own, found, strict=True):
                runs[entry] = Run(entry, summary, reasons[entry[::2]])
                told(f"{entry}{how}")
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
    """Summarise a test against the exact response, cut to the steps that it lasted."""
    steps = len(record.series[RIG_STATE.name].steps)
    parts = {field.name: getattr(reference, field.name)[:steps] for field in fields(reference)}
    return summarise_briefly(record, ReferenceResponse(**parts))


def step_cost(tournament: Tournament, mass_ratio: float, method: str) -> float:
    """Time of a step of the reference force alone, in s: the median of some passes.

    It is shown the response of a perfect test on the configured rig, beginning with the
    strongest shaking, so that methods which identify have something to identify. A first pass
    warms up and does not count.
    """
    experiment = tournament.experiment_of(Entry(mass_ratio, 0, method))
    blocks = build_blocks(experiment)
    motion, block = blocks.ground_motion, blocks.reference_force
    strongest = int(np.abs(motion.samples).max(axis=1).argmax())
    start = max(0, min(strongest - _COST_STEPS // 4, motion.steps - _COST_STEPS))
    stop = min(start + _COST_STEPS, motion.steps)
    exact = reference_response(experiment, motion.samples[:stop])
    states = np.stack(
        [exact.displacement, exact.velocity, exact.acceleration, exact.force], axis=1
    )[start:stop]
    preview = 1 + block.preview
    step = block.step
    windows = [motion.known[at : at + preview] for at in range(start, stop)]

    def one_pass() -> None:
        block.reset()
        for window, state in zip(windows, states, strict=True):
            step(window, state)

    one_pass()
    return median(timeit.repeat(one_pass, number=1, repeat=_COST_REPEATS)) / len(states)


@contextmanager
def _named(name: str) -> Iterator[None]:
    """Say in one line what went wrong in which test."""
    try:
        yield
    except SeftError as error:
        raise type(error)(f"{name}: {error}") from None
    except Exception as error:
        raise ExperimentError(f"{name}: {type(error).__name__}: {error}") from error
