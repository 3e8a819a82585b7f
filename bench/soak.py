"""Memory and open files of each node process in a long test in realtime, flat after warm-up.

python bench/soak.py --minutes 30
"""

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from _runs import CONFIG, use_own_domain
from seft_msgs_py.config.experiment import Experiment
from seft_ros.bags.recording_bag import read_bag
from seft_ros.test_run.parameter_tables import TABLES
from seft_ros.test_run.processes import MODULES
from seft_ros.test_run.run import run_experiment

PERIOD = 1.0  # s between samples
WARM_UP = 0.2  # of the time
MAX_GROWTH = 2.0  # MB after warm-up; the allocator's own steps are about one
INDEX = 8.0  # MB/h: the recorder keeps some 400 bytes of its bag's index for each flush, 4 a second
SPARE = 1.2  # the motion must not end before the time
PATIENT = ("supervisor", "peer"), ("rig", "command"), ("rig", "supervisor")
MEGABYTE = 1024  # kB


class Samples:
    """Memory of the node processes, as the progress of a run comes by; ends it when it is time.

    Parameters
    ----------
    minutes : float
        Time from the test's first step on.
    """

    def __init__(self, minutes: float) -> None:
        self.times: list[float] = []
        self.memory: dict[str, list[float]] = {}
        self.files: dict[str, list[int]] = {}
        self.steps = 0
        self._seconds = 60.0 * minutes
        self._started = 0.0
        self._pids: dict[str, int] = {}

    def take(self, what: str, done: int) -> None:
        """Hear of a run's progress."""
        if what != "running" or not done:
            return
        now = time.monotonic()
        if not self._pids:
            self._pids = {"seft": os.getpid(), **node_processes()}
            self.memory = {name: [] for name in self._pids}
            self.files = {name: [] for name in self._pids}
            self._started = now
        self.steps = done
        if now - self._started > self._seconds:
            raise KeyboardInterrupt  # as an operator ends a test
        if not self.times or now - self._started - self.times[-1] >= PERIOD:
            self.times.append(now - self._started)
            for name, pid in self._pids.items():
                self.memory[name].append(anonymous_memory(pid))
                self.files[name].append(len(list(Path(f"/proc/{pid}/fd").iterdir())))


def node_processes() -> dict[str, int]:
    """Process numbers of the nodes that this process has had started."""
    found = {}
    for pid in [each for starter in children(os.getpid()) for each in children(starter)]:
        words = Path(f"/proc/{pid}/cmdline").read_text().rstrip("\0").split(" ")
        found |= {node: pid for node, module in MODULES.items() if module in words}
    return found


def children(pid: int) -> list[int]:
    """Process numbers of what a process's first thread has started."""
    return [int(each) for each in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def anonymous_memory(pid: int) -> float:
    """Resident memory of a process that is its own, MB: what a leak makes grow."""
    status = Path(f"/proc/{pid}/status").read_text()
    return int(status.split("RssAnon:")[1].split()[0]) / MEGABYTE


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=1.0)
    minutes = parser.parse_args().minutes
    use_own_domain()
    samples = Samples(minutes)
    overrides = [
        # who waits for a processor breaks nothing
        *((name, f"watchdog.{what}_timeout", 60.0) for name, what in PATIENT),
        ("supervisor", "watchdog.missed_share", 1.0),
        ("reference_force", "instability.ratio", 0.0),
        ("ground_motion", "time_scale", 1.0),
        ("ground_motion", "synthetic.duration", SPARE * 60.0 * minutes + 10.0),
    ]
    experiment = Experiment.load(TABLES, [CONFIG], overrides)
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        fault, bag = run_experiment(experiment, bag, samples.take)
        recording = read_bag(bag)
    states = len(recording.series["rig/state"].steps)
    print(f"{samples.steps:,} steps in {minutes:g} min, {states:,} states in the bag")
    broken = fault or ("" if recording.stopped else f"it ended early: {recording.trip}")
    if broken or states < samples.steps:
        print(f"the test broke: {broken or 'states are missing in the bag'}", file=sys.stderr)
        return 1
    return 0 if is_flat(samples, minutes) else 1


def is_flat(samples: Samples, minutes: float) -> bool:
    """Print how memory and open files went; say whether they are flat in all processes."""
    times = np.array(samples.times)
    late = times >= WARM_UP * 60.0 * minutes
    allowed = MAX_GROWTH + INDEX * (1.0 - WARM_UP) * minutes / 60.0
    flat = True
    print("private memory, MB  at first  after warm-up  largest  at last   slope, MB/h  files")
    for name, values in samples.memory.items():
        memory = np.array(values)
        after = memory[late]
        slope = np.polyfit(times[late], after, 1)[0] * 3600.0
        growth = after[-1] - after[0]
        files = [
            number for number, is_late in zip(samples.files[name], late, strict=True) if is_late
        ]
        holds = growth <= allowed and max(files) <= files[0] + 1  # one may be read in passing
        flat &= holds
        print(
            f"{name:18} {memory[0]:9.1f} {after[0]:14.1f} {after.max():8.1f} {after[-1]:8.1f} "
            f"{slope:13.2f} {files[0]:3} {max(files):3}{'' if holds else '   NOT FLAT'}"
        )
    return flat


if __name__ == "__main__":
    sys.exit(main())
