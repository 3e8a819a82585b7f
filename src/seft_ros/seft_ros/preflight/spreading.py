"""Work on a plan, spread over processes where it takes long."""

import multiprocessing
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any

from seft_msgs_py.experiment import Experiment

from seft_ros.loop_shaping.source import Source
from seft_ros.preflight.plan import Plan

POOL_WORTH = 5.0
"""Time of a processor from which on more processes are started, s: each takes a second."""

_SINGLE = "OPENBLAS_NUM_THREADS"


def spread[Item, Result](
    plan: Plan, task: Callable[[Plan, Item], Result], items: Sequence[Item], expected: float
) -> Iterator[Result]:
    """Do a task on every item, in order.

    Parameters
    ----------
    plan : Plan
        What the task is about.
    task : callable
        A module's function.
    items : sequence
        What it is done on.
    expected : float
        Time that all take one processor, s.
    """
    workers = min(len(os.sched_getaffinity(0)), len(items))
    if expected < POOL_WORTH or workers < 2:
        yield from map(partial(task, plan), items)
        return
    context = multiprocessing.get_context("spawn")  # the caller may have threads
    before = os.environ.get(_SINGLE)
    os.environ[_SINGLE] = "1"  # for the workers: their threads would be in each other's way
    own = plan.experiment, plan.source
    try:
        with ProcessPoolExecutor(workers, context, _begin, own) as pool:
            yield from pool.map(partial(_do, task), items)
    finally:
        if before is None:
            del os.environ[_SINGLE]
        else:
            os.environ[_SINGLE] = before


def time_of_one(plan: Plan) -> float:
    """Time that one growth rate takes, the method made anew, s."""
    start = time.perf_counter()
    plan.loop(stiffness=1.0 + 1e-3).growth_rate()
    return time.perf_counter() - start


_plans: list[Plan] = []


def _begin(experiment: Experiment, source: Source) -> None:
    _plans[:] = [Plan(experiment, source)]


def _do(task: Callable[[Plan, Any], Any], item: Any) -> Any:
    return task(_plans[0], item)
