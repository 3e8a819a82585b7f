"""A study on a Dask cluster: the same numbers, and a worker that is killed loses nothing."""

import json
import os
import signal
import subprocess
import sys
import time
from threading import Thread

import pytest
from commands_at_hand import run_seft
from graph_tools import JHU

pytest.importorskip("distributed")
pytestmark = [pytest.mark.thorough, pytest.mark.cluster]
SHORT = ("-p", "ground_motion:synthetic.duration:=4", "-p", "ground_motion:tail:=0.5")


def started(folder, *words):
    """Start a program of Dask; it ends with its own process group."""
    with (folder / f"{words[0]}-{time.monotonic_ns()}.log").open("w") as log:
        return subprocess.Popen(
            [sys.executable, "-m", "distributed.cli.dask_" + words[0], *words[1:]],
            cwd=folder,
            stdout=log,
            stderr=log,
            start_new_session=True,
        )


@pytest.fixture
def cluster(tmp_path):
    """Address of a scheduler with two workers, and the workers."""
    file = tmp_path / "scheduler.json"
    loopback = ("--host", "127.0.0.1", "--no-dashboard")
    programs = [started(tmp_path, "scheduler", *loopback, "--port", "0", "--scheduler-file", file)]
    try:
        while not file.exists():
            assert programs[0].poll() is None
            time.sleep(0.1)
        address = json.loads(file.read_text())["address"]
        of_a_worker = (*loopback, "--nthreads", "1", "--nworkers", "1", "--no-nanny")
        for _ in range(2):
            programs.append(started(tmp_path, "worker", address, *of_a_worker))
        yield address, programs[1:]
    finally:
        for program in programs:
            if program.poll() is None:
                os.killpg(program.pid, signal.SIGKILL)
            program.wait()


def numbers(folder, *words):
    folder.mkdir()
    status, out, err = run_seft(folder, "study", JHU, *SHORT, *words, "--json")
    assert status == 0, err
    return json.loads(out)


def test_a_cluster_gives_the_numbers_of_this_machine_and_a_killed_worker_loses_nothing(
    cluster, tmp_path
):
    address, workers = cluster
    record = tmp_path / "elsewhere.csv"  # the workers get what it holds, not its path
    record.write_text("".join(f"{(-1) ** (k // 25) * k / 800}\n" for k in range(800)))
    words = ("--tests", "300", "--motion", str(record), "-p", "ground_motion:dt:=0.005")
    words = (*words, "-p", "ground_motion:unit:=m/s2")
    alone = numbers(tmp_path / "alone", *words, "--workers", "1")
    folder = tmp_path / "cluster"

    def kill_one():
        for _ in range(20_000):
            if list(folder.glob("study-*.jsonl")):
                break
            time.sleep(0.005)
        os.killpg(workers[0].pid, signal.SIGKILL)

    killer = Thread(target=kill_one, daemon=True)
    killer.start()
    spread = numbers(folder, *words, "--scheduler", address)
    killer.join()
    assert workers[0].wait(timeout=5) == -signal.SIGKILL
    assert spread == alone
    assert list(folder.glob("*.jsonl")) == []


def test_a_worker_with_other_software_is_refused(cluster, monkeypatch, tmp_path):
    address, _ = cluster
    monkeypatch.setattr("seft_ros.study.workers.software", lambda: "another text")
    words = ("study", JHU, *SHORT, "--tests", "2", "--scheduler", address)
    status, _, errors = run_seft(tmp_path, *words)
    assert status == 2
    assert "has other software" in errors and "than this machine (another text)" in errors
