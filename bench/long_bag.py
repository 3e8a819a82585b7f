"""Time and memory of `seft report` and `seft compare` on the bag of a long test at 1 kHz.

The bag holds a test of a minute, with estimates, over and over: what is in it costs nothing to
know, only how much. Each command runs in a process of its own. `--minutes N` for a quick look:
then the memory, of which the libraries take a part, says less. `--keep FOLDER` leaves the bags
there for the next time, as they take minutes to write.
"""

import argparse
import os
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from seft_msgs_py.config.experiment import Experiment
from seft_ros.bags.recording import Estimates, Recording, Series
from seft_ros.bags.recording_bag import write_recording
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.offline import simulate_test
from seft_ros.test_run.parameter_tables import TABLES

CONFIG = Path(__file__).parent.parent / "config" / "demo.yaml"
MINUTE = [
    ("/**", "rate", 1000.0),
    ("/**", "actuator.kind", "servo_hydraulic_linear"),
    ("ground_motion", "time_scale", 1.0),
    ("ground_motion", "tail", 0.0),
    ("ground_motion", "synthetic.duration", 60.0),
]
STEPS = 60_000  # of a minute
WANTED_TIMES_REAL_TIME = 50  # for each bag that is read
WANTED_BYTES = 1e9


def long_recording(minutes: int) -> Recording:
    """Make the recording of a test that repeats itself every minute."""
    experiment = Experiment.load(TABLES, [CONFIG], MINUTE)
    minute = simulate_test(experiment, build_blocks(experiment))
    series = {}
    for name, one in minute.series.items():
        values = np.tile(one.values[:STEPS], (minutes, 1, 1))
        series[name] = Series(np.arange(len(values)), values)
    found = minute.estimates
    if found is None:
        raise RuntimeError("the compensation method of demo.yaml identified nothing")
    within = found.steps < STEPS
    starts = STEPS * np.arange(minutes)[:, np.newaxis]
    steps = (starts + found.steps[within]).ravel()
    estimates = Estimates(steps, np.tile(found.values[within], (minutes, 1, 1)), found.names)
    return replace(minute, series=series, estimates=estimates)


def measured(*words: str) -> tuple[float, float]:
    """Run a `seft` command; give seconds of wall time and the peak of resident memory in bytes."""
    command = [sys.executable, "-m", "seft_ros.cli.main", *words]
    quiet = [(os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0)]
    start = time.perf_counter()
    child = os.posix_spawn(sys.executable, command, dict(os.environ), file_actions=quiet)
    _, status, usage = os.wait4(child, 0)
    if os.waitstatus_to_exitcode(status) not in (0, 1):
        raise RuntimeError(f"seft {' '.join(words)} failed")
    return time.perf_counter() - start, usage.ru_maxrss * 1024.0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=int, default=60, help="length of the test")
    parser.add_argument("--keep", metavar="FOLDER", help="where bags are, or will be left")
    options = parser.parse_args()
    minutes, met = options.minutes, True
    with tempfile.TemporaryDirectory() as folder:
        bag = str(Path(options.keep or folder) / f"{minutes}_minutes")
        if not Path(bag).exists():
            recording = long_recording(minutes)
            ground = recording.series["ground_motion"].values[:, 0]
            motion = [(at, ground[at : at + 100]) for at in range(0, len(ground), 100)]
            write_recording(recording, bag, motion)
            del recording, ground, motion
        print(f"{minutes} minutes at 1 kHz; wanted: {WANTED_TIMES_REAL_TIME} times real time for")
        print(f"each bag that is read, and at most {WANTED_BYTES / 1e6:.0f} MB")
        for words in (("report", bag, "--json"), ("compare", bag, bag, "--json")):
            seconds, peak = measured(*words)
            speed = words.count(bag) * minutes * 60 / seconds
            met &= speed >= WANTED_TIMES_REAL_TIME and peak <= WANTED_BYTES
            print(f"{words[0]:18s} {seconds:6.1f} s, {speed:5.0f} times, {peak / 1e6:5.0f} MB")
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
