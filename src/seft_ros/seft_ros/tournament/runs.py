"""The tests of a tournament, and what each was worth."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from typing import Any

from seft_msgs_py.errors import ExperimentError, SeftError
from seft_msgs_py.experiment import Experiment
from seft_msgs_py.topics import RIG_STATE
from seft_plant_sim.whole_structure import ReferenceResponse, reference_response

from seft_ros.analysis.summary import summarise
from seft_ros.experiment.blocks import build_blocks
from seft_ros.experiment.offline import simulate
from seft_ros.ground_motion.block import GroundMotion
from seft_ros.tournament.entries import Entry, Tournament
from seft_ros.tournament.workers import parallel_map

Progress = Callable[[str, int], None]

_KEPT = ("steps", "stable", "trip", "saturated", "displacement", "acceleration", "force")


@dataclass(frozen=True)
class Run:
    """One test and its outcome.

    Attributes
    ----------
    entry : Entry
        Which test.
    summary : dict
        Of what `seft_ros.analysis.summary.summarise` says: steps, stable, trip, saturated,
        displacement, acceleration, force.
    """

    entry: Entry
    summary: dict[str, Any]

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

    Parameters
    ----------
    tournament : Tournament
        Its entries are run in their order.
    workers : int
        Number of processes.
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

    references, runs = {}, []
    with parallel_map(min(workers, len(entries))) as map_:
        titles = [f"mass ratio {ratio:g}, rig {rig}, exact" for ratio, rig in structures]
        responses = map_(_exact_response, titles, structures.values())
        for key, title, response in zip(structures, titles, responses, strict=True):
            references[key] = response
            told(title)
        exact = [references[entry[:2]] for entry in entries]
        for entry, name, summary in zip(
            entries, names, map_(_outcome, names, experiments, exact), strict=True
        ):
            runs.append(Run(entry, summary))
            told(name)
    return runs


def _exact_response(name: str, experiment: Experiment) -> ReferenceResponse:
    with _named(name):
        motion = GroundMotion.from_parameters(
            experiment["ground_motion"], experiment.axes, experiment.timebase
        )
        return reference_response(experiment, motion.samples)


def _outcome(name: str, experiment: Experiment, reference: ReferenceResponse) -> dict[str, Any]:
    with _named(name):
        record = simulate(experiment, build_blocks(experiment))
        steps = len(record.series[RIG_STATE.name].steps)
        summary = summarise(record, _first(reference, steps))
        return {key: summary[key] for key in _KEPT}


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
