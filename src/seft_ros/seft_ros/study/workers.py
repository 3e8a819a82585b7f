"""Calculations on several processes, of this machine or of a cluster.

Here it is Python's own pool of processes: it starts in two thirds of the time of Dask's local
cluster, in half the processes, and needs no Dask.
"""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

from seft_msgs_py.errors import ExperimentError, InputError

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
            wanted = software()
            yield lambda function, *arguments: _spread(
                executor, partial(_calculate_alike, wanted, function), *arguments
            )
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
            mend = "the same command with fewer --workers continues"
            raise ExperimentError(f"a worker died, maybe for want of memory; {mend}") from None
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
        mend = "install it with: pip install 'seft_ros[dask]'"
        raise InputError(f"--scheduler: Dask is not installed; {mend}") from None
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
        why = f"a worker lacks {error.name}; install seft there"
        raise InputError(f"--scheduler {address}: {why}") from None


def _spread(
    executor: Executor, function: Callable[..., Any], *arguments: Any
) -> Iterator[tuple[int, Any]]:
    """Begin to calculate, see `Map`."""
    # what is started here inherits the mask: Ctrl-C is for the parent alone to deal with
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        calls = enumerate(zip(*arguments, strict=False))
        places = {executor.submit(function, *each): place for place, each in calls}
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
    from seft_plant_sim.compiled import code_folder  # workers of this machine begin without it

    text = code_folder(Path(__file__).parents[1]).name  # numba's version is in it
    return f"{text}, numpy {version('numpy')}, scipy {version('scipy')}"
