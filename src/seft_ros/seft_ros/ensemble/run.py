"""An ensemble: tests that can be compiled, on several threads."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from seft_msgs_py.experiment import Experiment

from seft_ros.ensemble.member import Workshop
from seft_ros.recording.record import Record

__all__ = ["Workshop", "run_ensemble", "thread_map"]


def run_ensemble[Result](
    experiments: Sequence[Experiment],
    reduce: Callable[[int, Record], Result],
    workers: int = 1,
    workshop: Workshop | None = None,
) -> Iterator[Result]:
    """Run tests, and give what is made of each, in their order.

    Parameters
    ----------
    experiments : sequence of Experiment
        All of which can be compiled, see `Workshop.obstacle`.
    reduce : callable
        From a test's number and record to its result; called on the thread that ran the test.
    workers : int
        Number of threads; the results do not depend on it.
    workshop : Workshop, optional
        With what is known of earlier tests.

    Raises
    ------
    NotLinearError
        If a test can't be compiled.
    """
    shop = workshop or Workshop()

    def one(number: int, experiment: Experiment) -> Result:
        return reduce(number, shop.run(experiment))

    yield from thread_map(workers, one, range(len(experiments)), experiments)


def thread_map(workers: int, function: Callable[..., Any], *arguments: Any) -> Iterator[Any]:
    """Give results in order, as `map` does, from several threads; 1: from this one alone."""
    if workers == 1:
        yield from map(function, *arguments)
        return
    pool = ThreadPoolExecutor(workers)
    try:
        yield from pool.map(function, *arguments)
    finally:
        pool.shutdown(cancel_futures=True)
