"""Several processes for independent calculations; they end with the process that started them."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from typing import Any

from seft_msgs_py.errors import ExperimentError

Map = Callable[..., Iterator[Any]]
"""A `map` over functions of modules, whose arguments and results can be pickled."""

_STOP = signal.SIGUSR1


class _StoppedError(BaseException):
    """The result is not wanted any more."""


def free_cores() -> int:
    """Count the processor cores that this process may use."""
    return len(os.sched_getaffinity(0))


@contextmanager
def parallel_map(workers: int) -> Iterator[Map]:
    """Give a `map` that calculates on several processes, and keeps the order.

    A worker is a fresh interpreter (spawn) with one thread for linear algebra, which
    `seft_msgs_py` sets. When the block is left early, the workers stop their calculations.

    Parameters
    ----------
    workers : int
        Number of processes; 1: this one alone.

    Raises
    ------
    ExperimentError
        If a worker dies.
    """
    if workers == 1:
        yield map
        return
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _become_worker)

    def spread(function: Callable[..., Any], *arguments: Any) -> Iterator[Any]:
        # what is started here inherits the mask: Ctrl-C is for the parent alone to deal with
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, _STOP})
        try:
            return pool.map(partial(_calculate, function), *arguments)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    try:
        yield spread
    except BrokenProcessPool:
        raise ExperimentError(
            "a worker died, maybe for want of memory; take fewer workers"
        ) from None
    except BaseException:
        for worker in set(multiprocessing.active_children()) - others:
            # not terminated: one that dies while it sends a result leaves the pool waiting for it
            if worker.pid is not None and worker.is_alive():
                os.kill(worker.pid, _STOP)
        raise
    finally:
        pool.shutdown(cancel_futures=True)


class _Worker:
    """What this process does, where it is a worker."""

    calculating = False
    stopping = False


def _become_worker() -> None:
    """Stop calculating on request, and end when the parent has ended for whatever reason."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    def stop(*_: object) -> None:
        _Worker.stopping = True
        if _Worker.calculating:
            raise _StoppedError

    threading.Thread(target=watch, daemon=True).start()
    signal.signal(_STOP, stop)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {_STOP})


def _calculate(function: Callable[..., Any], *arguments: Any) -> Any:
    _Worker.calculating = True
    try:
        if _Worker.stopping:
            raise _StoppedError
        return function(*arguments)
    finally:
        _Worker.calculating = False
