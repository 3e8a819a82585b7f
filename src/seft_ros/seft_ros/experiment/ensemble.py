"""Many tests at once: those of the offline loop, on several threads.

Tests whose ground motion, reference force or force controller are the same share them: the rigs
alone differ from member to member of most ensembles.
"""

import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import Any

from seft_msgs_py.config.experiment import Experiment

from seft_ros.experiment.block_steps import obstacle
from seft_ros.experiment.blocks import Blocks, build_blocks
from seft_ros.experiment.offline import simulate
from seft_ros.recording.environment import describe_environment
from seft_ros.recording.record import Record


class Workshop:
    """Makes the tests of an ensemble ready, and runs them; each thread has blocks of its own."""

    def __init__(self) -> None:
        self._of_thread = threading.local()

    @cached_property
    def _environment(self) -> dict[str, Any]:
        return describe_environment("ensemble")

    def run(self, experiment: Experiment) -> Record:
        """Run a test, see `simulate`.

        Raises
        ------
        InputError
            As `build_blocks`.
        """
        return simulate(experiment, self.blocks(experiment), environment=self._environment)

    def obstacle(self, experiment: Experiment) -> str:
        """Say why a test can't run in the compiled loop, see `obstacle`; empty if it can."""
        return obstacle(self.blocks(experiment))

    def blocks(self, experiment: Experiment) -> Blocks:
        """Make the blocks of a test, or find them among those of this thread's earlier tests."""
        return build_blocks(experiment, vars(self._of_thread))


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
        Those which the compiled loop can run make use of all threads.
    reduce : callable
        From a test's number and record to its result; called on the thread that ran the test.
    workers : int
        Number of threads; the results do not depend on it.
    workshop : Workshop, optional
        With what is known of earlier tests.
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
