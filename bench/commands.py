"""Processor time of short commands, beside that of importing the libraries that they stand on.

Each in a process of its own, with machine code from the disk. And the tests of a study on all cores
beside one.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

DEMO = Path(__file__).parent.parent / "config" / "demo.yaml"
ROUNDS = 5
TESTS = 400
IMPORTS = "import numba, numpy, rich.progress, scipy.linalg, scipy.interpolate, typer"
COMMANDS = {  # arguments, imports of the floor, times of the floor's wanted
    "seft simulate": (["simulate", str(DEMO)], IMPORTS, 3.0),
    "seft report": (["report", "bag"], f"{IMPORTS}, bokeh.plotting, jinja2, rosbags.rosbag2", 4.0),
}
SPREAD_WANTED = 0.6  # of the number of cores


def processor_time(folder: str, *words: str) -> float:
    """Processor time of a Python process, s."""
    before = os.times()
    subprocess.run([sys.executable, *words], cwd=folder, check=True, capture_output=True)
    after = os.times()
    return sum(after[2:4]) - sum(before[2:4])


def study(folder: str, workers: int) -> float:
    """Time of a study's tests on so many processes, s."""
    words = ["study", str(DEMO), "--tests", str(TESTS), "--workers", str(workers), "--json"]
    start = time.perf_counter()
    command = [sys.executable, "-m", "seft_ros.cli.main", *words]
    done = subprocess.run(command, cwd=folder, check=True, capture_output=True)
    taken = time.perf_counter() - start
    assert len(json.loads(done.stdout)["results"][0]["runs"]) == TESTS
    return taken


def main() -> int:
    met = True
    with tempfile.TemporaryDirectory() as folder:
        seft = ("-m", "seft_ros.cli.main")
        processor_time(folder, *seft, "simulate", str(DEMO), "--out", "bag")
        for name, (words, imports, wanted) in COMMANDS.items():
            taken = floor = float("inf")
            processor_time(folder, *seft, *words)  # compiled
            for _ in range(ROUNDS):  # interleaved: the machine's speed drifts
                taken = min(taken, processor_time(folder, *seft, *words))
                floor = min(floor, processor_time(folder, "-c", imports))
            met &= taken <= wanted * floor
            print(
                f"{name:14s} {taken:.2f} s of a processor, {taken / floor:.2f} times the imports' "
                f"{floor:.2f} s (wanted: at most {wanted:g})"
            )
        cores = len(os.sched_getaffinity(0))
        one, all_ = (min(study(folder, n) for _ in range(2)) for n in (1, cores))
        met &= one / all_ >= SPREAD_WANTED * cores
        print(
            f"{TESTS} tests: {one:.1f} s on one core, {one / all_:.2f} times as fast on {cores} "
            f"(wanted: {SPREAD_WANTED * cores:g})"
        )
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
