"""The tests of a tournament are run: the error of each, and what a step of a method costs."""

import timeit
from collections.abc import Callable
from dataclasses import dataclass, fields
from itertools import repeat
from statistics import median
from typing import Any

import numpy as np
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import ExperimentError, SeftError
from seft_msgs_py.wire.topics import RIG_STATE
from seft_plant_sim.whole_structure import ReferenceResponse, reference_response

from seft_ros.analysis.summary import summarise_briefly
from seft_ros.bags.record import Record
from seft_ros.ground_motion.ground_motion_block import GroundMotion
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.offline import Workshop, simulate, thread_map
from seft_ros.tournament.entries import Entry, Tournament
from seft_ros.tournament.workers import parallel_map

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
        Why it ran on the uncompiled blocks of `seft simulate`; empty: on the compiled loop.
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
        """Whether it neither tripped nor has samples that are not finite."""
        return bool(self.summary["stable"])

    @property
    def nrmse(self) -> float | None:
        """Error of the displacement; None where the test was unstable or it is undefined."""
        error: float | None = self.summary["displacement"]["nrmse"]
        return error if self.stable else None


def count_calculations(tournament: Tournament) -> int:
    """Count what `run_all` calculates: tests, and reference responses."""
    entries = tournament.entries()
    return len(entries) + len({entry[:2] for entry in entries})


def run_all(
    tournament: Tournament, workers: int = 1, progress: Callable[[str, int], None] | None = None
) -> list[Run]:
    """Run all tests offline; the results do not depend on the number of workers.

    A test that the compiled loop can't run (`Workshop.obstacle`) is run by the uncompiled blocks,
    which takes many times as long, and is named so.

    Parameters
    ----------
    tournament : Tournament
        Its entries are run in their order, the compiled ones first.
    workers : int
        Number of threads for those, and of processes for the others.
    progress : callable, optional
        Called with what was calculated, and how much was so far.

    Raises
    ------
    ExperimentError
        If a test could not be calculated; names it.
    """
    entries, shop = tournament.entries(), Workshop()
    experiments = {entry: tournament.experiment_of(entry) for entry in entries}
    structures = {entry[:2]: experiment for entry, experiment in experiments.items()}
    # the rigs of a tournament differ in numbers alone, so that one represents all
    obstacles = {e[::2]: shop.obstacle(experiments[e]) for e in entries if e.rig == 0}
    references: dict[tuple[float, int], ReferenceResponse] = {}
    runs: dict[Entry, Run] = {}

    def report(what: str) -> None:
        if progress is not None:
            progress(what, len(references) + len(runs))

    def compiled(entry: Entry) -> dict[str, Any]:
        return _brief(shop.run(experiments[entry]), references[entry[:2]])

    with parallel_map(min(workers, len(entries))) as map_:
        titles = [f"mass ratio {ratio:g}, rig {rig}, exact" for ratio, rig in structures]
        responses = thread_map(workers, _named, titles, repeat(_exact), structures.values())
        for key, title, response in zip(structures, titles, responses, strict=True):
            references[key] = response
            report(title)
        plain = [entry for entry in entries if obstacles[entry[::2]]]
        quick = [entry for entry in entries if not obstacles[entry[::2]]]
        # the processes begin at once, and go on beside the threads
        outcomes = map_(
            _named,
            map(str, plain),
            repeat(_uncompiled),
            [experiments[entry] for entry in plain],
            [references[entry[:2]] for entry in plain],
        )
        summaries = thread_map(workers, _named, map(str, quick), repeat(compiled), quick)
        for own, found, how in ((quick, summaries, ""), (plain, outcomes, " (plain blocks)")):
            for entry, summary in zip(own, found, strict=True):
                runs[entry] = Run(entry, summary, obstacles[entry[::2]])
                report(f"{entry}{how}")
    return [runs[entry] for entry in entries]


def _named(name: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function; an error says in one line which test it is of."""
    try:
        return function(*arguments)
    except SeftError as error:
        raise type(error)(f"{name}: {error}") from None
    except Exception as error:
        raise ExperimentError(f"{name}: {type(error).__name__}: {error}") from error


def _exact(experiment: Experiment) -> ReferenceResponse:
    motion = GroundMotion.from_parameters(
        experiment["ground_motion"], experiment.axes, experiment.timebase
    )
    return reference_response(experiment, motion.samples)


def _uncompiled(experiment: Experiment, reference: ReferenceResponse) -> dict[str, Any]:
    return _brief(simulate(experiment, build_blocks(experiment)), reference)


def _brief(record: Record, reference: ReferenceResponse) -> dict[str, Any]:
    """Summarise a test against the reference response, cut to the steps that it lasted."""
    steps = len(record.series[RIG_STATE.name].steps)
    parts = {field.name: getattr(reference, field.name)[:steps] for field in fields(reference)}
    return summarise_briefly(record, ReferenceResponse(**parts))


def step_cost(tournament: Tournament, mass_ratio: float, method: str) -> float:
    """Time a step of the reference force alone: the median of some passes, s.

    Its input is the reference response of the configured rig, beginning with the strongest shaking,
    so that methods which identify have something to identify. A first pass warms up and does not
    count.
    """
    experiment = tournament.experiment_of(Entry(mass_ratio, 0, method))
    blocks = build_blocks(experiment)
    motion, block = blocks.ground_motion, blocks.reference_force
    strongest = int(np.abs(motion.samples).max(axis=1).argmax())
    start = max(0, min(strongest - _COST_STEPS // 4, motion.steps - _COST_STEPS))
    stop = min(start + _COST_STEPS, motion.steps)
    exact = reference_response(experiment, motion.samples[:stop])
    measured = (exact.displacement, exact.velocity, exact.acceleration, exact.force)
    states = np.stack(measured, axis=1)[start:stop]
    windows = [motion.known[at : at + 1 + block.preview] for at in range(start, stop)]
    step = block.step

    def one_pass() -> None:
        block.reset()
        for window, state in zip(windows, states, strict=True):
            step(window, state)

    one_pass()
    return median(timeit.repeat(one_pass, number=1, repeat=_COST_REPEATS)) / len(states)
