import multiprocessing
import operator
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest
from seft_msgs_py.errors import ExperimentError
from seft_ros.study.workers import parallel_map

KILLED = """
import os, signal
from seft_ros.study.workers import parallel_map
with parallel_map(2) as map_:
    print(dict(map_(eval, ["__import__('os').getpid()"]))[0], flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
"""


POWERS = ([2, 3, 4], [3, 2, 1]), {0: 8, 1: 9, 2: 4}


def test_workers_have_one_thread_for_linear_algebra_and_are_deaf_to_ctrl_c():
    with parallel_map(2) as map_:
        assert dict(map_(pow, *POWERS[0])) == POWERS[1]
        ((_, threads),) = map_(os.getenv, ["OPENBLAS_NUM_THREADS"])
        ((_, mask),) = map_(signal.pthread_sigmask, [signal.SIG_BLOCK], [()])
    assert threads == os.environ["OPENBLAS_NUM_THREADS"]
    assert signal.SIGINT in mask
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_an_error_in_a_worker_comes_through_and_ends_them_all():
    with pytest.raises(ZeroDivisionError), parallel_map(2) as map_:
        list(map_(operator.truediv, [1, 1], [0, 1]))
    assert multiprocessing.active_children() == []


def test_a_worker_that_died_is_reported():
    with pytest.raises(ExperimentError, match="a worker died"), parallel_map(2) as map_:
        list(map_(os._exit, [3]))
    assert multiprocessing.active_children() == []


def test_an_interruption_stops_calculations_that_are_under_way():
    with pytest.raises(KeyboardInterrupt), parallel_map(2) as map_:
        assert next(map_(pow, [2], [3])) == (0, 8)  # one is up
        map_(time.sleep, [1000.0] * 6)
        raise KeyboardInterrupt
    assert multiprocessing.active_children() == []


def test_workers_end_with_a_parent_that_is_killed():
    words = [sys.executable, "-c", KILLED]
    ended = subprocess.run(words, capture_output=True, text=True, check=False)
    assert ended.returncode == -signal.SIGKILL
    with suppress(FileNotFoundError, ProcessLookupError):  # one that nobody waited for has ended
        stat = Path(f"/proc/{int(ended.stdout)}/stat")
        while stat.read_text().rpartition(")")[2].split()[0] != "Z":
            time.sleep(0.05)


def test_the_machine_code_is_in_the_same_place_in_every_process():
    # a process hashes texts, and so orders sets, in its own way
    text = "from seft_ros.study.workers import software; print(software())"
    seeds = [os.environ | {"PYTHONHASHSEED": seed} for seed in "01"]
    words = [sys.executable, "-c", text]
    assert len({subprocess.check_output(words, env=seed) for seed in seeds}) == 1
