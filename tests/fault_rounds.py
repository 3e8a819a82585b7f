"""Many runs that are started, stopped and killed at random moments; none may leave anything.

    python tests/fault_rounds.py --rounds 200 --seed 1

Each round is one `seft run`, of which a seeded generator chooses pace, what is done to it
and when. It ends at the first thing that is wrong, and says how to do that round again. What a
round sees of its run is what an operator sees: the progress bar, on a terminal of its own.
"""

import argparse
import contextlib
import os
import pty
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from graph_tools import (
    JHU,
    MISSES_ALLOWED,
    PATIENCE,
    STALLS_ALLOWED,
    children,
    shared_memory,
)
from seft_msgs_py.errors import InputError
from seft_ros.bags.bag_files import recover_bag
from seft_ros.bags.record import Record
from seft_ros.bags.record_bag import read_bag
from seft_ros.test_run.processes import MODULES

MOMENTS = ("starting", "ready", "running", "ramping down", "ending")
ACTIONS = (
    *("nothing", "SIGINT", "SIGTERM", "two SIGINT", "three SIGINT"),
    *("stop", "estop", "kill the run"),
    *(f"kill {node}" for node in MODULES),
    *(f"halt {node}" for node in MODULES),
)
MARK = "SEFT_FAULT_ROUND"
"""Environment variable by which a round knows all its processes."""
LOOK = 0.02  # s
PEERS_MAY_STALL = (
    *("-p", "supervisor:watchdog.peer_timeout:=4.0"),
    *("-p", "rig:watchdog.supervisor_timeout:=4.0"),
)
"""Lets a node go on that has waited for a processor for seconds."""
STEPS = {"lockstep": 8000, "realtime": 1100}
"""Steps of a test, about: a few seconds of wall time."""


class RoundError(Exception):
    """Something that must not be."""


@dataclass(frozen=True)
class Plan:
    """What is done in a round.

    Attributes
    ----------
    pace : str
        Parameter of the rig.
    moment : str
        One of `MOMENTS`.
    share : float
        How far into that moment, from 0 to 1.
    action : str
        One of `ACTIONS`.
    """

    pace: str
    moment: str
    share: float
    action: str

    @classmethod
    def of(cls, seed: int, number: int) -> "Plan":
        """Choose one; the same for the same seed and round."""
        chance = random.Random(f"{seed}/{number}")
        return cls(
            chance.choice(("lockstep", "realtime")),
            # every second fault hits a test that runs
            chance.choice((*MOMENTS, "running", "running", "ramping down")),
            chance.random(),
            chance.choice(ACTIONS),
        )

    def __str__(self) -> str:
        when = f"{self.moment} ({self.share:.0%})"
        return f"{self.pace:8} {when:19} {self.action}"

    @property
    def words(self) -> list[str]:
        """Overrides of the configuration."""
        # the motion is compressed in time by half, and has 0.2 s of tail
        duration = 2.0 * (STEPS[self.pace] / 500.0 - 0.2)
        ramp = 1.0 if self.pace == "realtime" else 6.0
        words = [*STALLS_ALLOWED[:2], *PEERS_MAY_STALL, *MISSES_ALLOWED]
        words += ["-p", f"rig:pace:={self.pace}"]
        words += ["-p", "ground_motion:tail:=0.2"]
        words += ["-p", f"ground_motion:synthetic.duration:={duration}"]
        return [*words, "-p", f"reference_force:ramp_down_time:={ramp}"]


class Run:
    """A `seft run` on a terminal.

    Attributes
    ----------
    process : subprocess.Popen
        It.
    pids : dict of str to int
        Its nodes, as far as they have been seen.
    shared : set of str
        Files in /dev/shm that its processes have had.
    """

    def __init__(self, words: list[str], folder: Path, mark: str) -> None:
        self._mark = f"{MARK}={mark}".encode()
        terminal, behind = pty.openpty()
        self.process = subprocess.Popen(
            [sys.executable, "-m", "seft_ros.cli.main", "run", str(JHU), *words],
            cwd=folder,
            env=os.environ | {MARK: mark, "COLUMNS": "300", "TERM": "xterm"},
            stdout=subprocess.DEVNULL,
            stderr=behind,
            start_new_session=True,
        )
        os.close(behind)
        self.pids: dict[str, int] = {}
        self.shared: set[str] = set()
        self._text = bytearray()
        self._reader = threading.Thread(target=self._read, args=(terminal,))
        self._reader.start()

    def _read(self, terminal: int) -> None:
        with contextlib.suppress(OSError):  # EIO: its other end is closed
            while data := os.read(terminal, 65536):
                self._text += data
        os.close(terminal)

    def look(self) -> None:
        """See which nodes there are, and what is theirs in /dev/shm."""
        self.pids |= children(self.process.pid)
        for pid in (self.process.pid, *self.pids.values()):
            self.shared.update(shared_memory(pid))

    @property
    def text(self) -> str:
        """What it has written, without the colours; each redrawing of a line is a line."""
        return plain(self._text)

    @property
    def bar(self) -> str:
        """What it shows now."""
        return plain(self._text[-4000:])

    @property
    def complaints(self) -> list[str]:
        """Lines on stderr that begin with its name."""
        self._reader.join()
        return [line for line in self.text.splitlines() if line.startswith("seft: ")]

    @property
    def step(self) -> int:
        """Last step on the bar."""
        found = re.findall(r"(\d+)/\d+", self.bar)
        return int(found[-1]) if found else 0

    @property
    def total(self) -> int:
        """Steps of its test, as the bar says."""
        found = re.findall(r"\d+/(\d+)", self.bar)
        return int(found[-1]) if found else 0

    def shows(self, words: str) -> bool:
        """Whether it says so now."""
        return words in self.bar

    def wait_for(self, condition: Callable[[], bool], what: str) -> bool:
        """Wait; whether it came so before the run's end."""
        deadline = time.monotonic() + PATIENCE
        while not condition():
            if self.process.poll() is not None:
                return False
            if time.monotonic() > deadline:
                raise RoundError(f"waited {PATIENCE:g} s for {what}; it shows\n{self.text[-800:]}")
            self.look()
            time.sleep(LOOK)
        self.look()
        return self.process.poll() is None

    def living(self) -> list[int]:
        """Process numbers of all that was started in this round and lives."""
        found = []
        for entry in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                state = (entry / "stat").read_text().rsplit(")", 1)[1].split()[0]
                if state != "Z" and self._mark in (entry / "environ").read_bytes().split(b"\0"):
                    found.append(int(entry.name))
        return found

    def clear_away(self) -> None:
        """Kill what is left of it."""
        for pid in self.living():
            with contextlib.suppress(OSError):
                os.kill(pid, signal.SIGKILL)
        self.process.wait()
        self._reader.join()


def plain(text: bytes) -> str:
    """Text from a terminal, without what moves the cursor and chooses colours."""
    found = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "\n", text.decode(errors="replace"))
    return found.replace("\r", "\n")


def come_to(plan: Plan, run: Run) -> bool:
    """Wait for the moment of a plan; whether it came before the end of the run."""
    if plan.moment == "starting":
        count = int(plan.share * (len(MODULES) + 1))
        if not run.wait_for(lambda: len(run.pids) >= count, f"{count} processes"):
            return False
        pause = time.monotonic() + 3.0 * (plan.share * 7.0 % 1.0)
        return run.wait_for(lambda: time.monotonic() >= pause, "a while")
    if plan.moment == "ready":
        return run.wait_for(lambda: run.shows("all nodes are ready"), "ready")
    steps = STEPS[plan.pace]
    if plan.moment == "running":
        first = int(0.9 * plan.share * steps)
        return run.wait_for(lambda: run.shows("running") and run.step >= first, f"step {first}")
    if plan.moment == "ramping down":
        first = int(0.4 * plan.share * steps)
        come = run.wait_for(lambda: run.shows("running") and run.step >= first, f"step {first}")
        run.process.send_signal(signal.SIGINT)
        return come and run.wait_for(lambda: run.shows("ramping down"), "the ramp")
    if not run.wait_for(lambda: run.step >= steps - 60, "its last steps"):
        return False
    pause = time.monotonic() + 2.0 * plan.share
    return run.wait_for(lambda: time.monotonic() >= pause, "its end")


def act(plan: Plan, run: Run) -> bool:
    """Do what a plan says; whether it could be done."""
    what, _, whom = plan.action.partition(" ")
    if what == "nothing":
        return True
    if what in ("stop", "estop"):
        return call(what)
    if plan.action == "kill the run":
        pid, number = run.process.pid, signal.SIGKILL
    elif what in ("kill", "halt"):
        if whom not in run.pids:
            run.wait_for(lambda: whom in run.pids, whom)
        pid = run.pids.get(whom, 0)
        number = signal.SIGKILL if what == "kill" else signal.SIGSTOP
    else:
        counts = {"two": 2, "three": 3}
        for _ in range(counts.get(what, 1)):
            if run.process.poll() is not None:
                return False
            number = signal.SIGTERM if what == "SIGTERM" else signal.SIGINT
            run.process.send_signal(number)
            time.sleep(0.1)
        return True
    try:
        os.kill(pid, number)
    except ProcessLookupError:
        return False
    return pid != 0


def call(service: str) -> bool:
    """Call a service of the supervisor, from a process that is gone afterwards."""
    words = (
        "from seft_ros.test_run.observer import Observer\n"
        "observer = Observer()\n"
        f"try: print(observer.call({service!r}, 5.0)[0])\n"
        "finally: observer.close()"
    )
    done = subprocess.run([sys.executable, "-c", words], capture_output=True, text=True)
    return done.stdout.strip() == "True"


def check_end(plan: Plan, run: Run, done: bool) -> None:
    """Check that exit status and words fit each other, and what was done."""
    status, told = run.process.returncode, run.complaints
    if "Traceback" in run.text:
        raise RoundError(f"a traceback:\n{run.text[-3000:]}")
    interrupted = plan.moment == "ramping down" or "SIG" in plan.action
    if status == 0:
        if told:
            raise RoundError(f"status 0, but it complains: {told}")
        late = plan.moment == "ending" or (plan.moment == "running" and run.step >= run.total)
        if plan.moment == "ramping down" or not (plan.action == "nothing" or not done or late):
            raise RoundError(f"status 0 in spite of {plan.action}")
        return
    if status == -signal.SIGKILL and plan.action == "kill the run":
        return
    if status == -signal.SIGTERM and plan.action == "SIGTERM":
        return  # so early or late that it could not be answered
    if status != 1:
        raise RoundError(f"status {status}: {told}")
    if len(told) != 1:
        raise RoundError(f"{len(told)} lines on stderr: {told}\n{run.text[-2000:]}")
    if interrupted and "interrupted" in told[0]:
        return
    what, _, node = plan.action.partition(" ")
    expected = {
        "kill": (f"node {node} ended (killed by signal 9)",),
        "halt": (f"node {node} ", f"is {node} running?"),
        "stop": ("stopped by the operator",),
        "estop": ("aborted by the operator",),
        "three": ("interrupted",),
    }.get(what, ())
    if not done or not any(words in told[0] for words in expected):
        raise RoundError(f"it says: {told[0]}")


def check_nothing_left(plan: Plan, run: Run) -> None:
    """Check for processes and for files in /dev/shm."""
    if plan.action == "kill the run":  # nobody waited for the end of the others
        deadline = time.monotonic() + 30.0
        while run.living() and time.monotonic() < deadline:
            time.sleep(LOOK)
    if living := run.living():
        names = [Path(f"/proc/{pid}/cmdline").read_bytes().decode() for pid in living]
        raise RoundError(f"processes left: {names}")
    if left := [file for file in run.shared if Path(file).exists()]:
        raise RoundError(f"left in /dev/shm: {sorted(left)}")


def check_bag(plan: Plan, bag: Path, told_at_start: bool) -> str:
    """Check that a bag can be read; tell what is in it.

    There may be nothing in it only where the run told a fault of its first moment.
    """
    if not bag.exists():
        return "no bag"
    for log in sorted(bag.glob("logs/*.log")):
        if "Traceback" in (text := log.read_text(errors="replace")):
            raise RoundError(f"a traceback in {log.name}:\n{text}")
    recovered = ""
    if plan.action == "kill recorder":
        try:
            recovered = "" if recover_bag(bag).intact else " (recovered)"
        except InputError as error:
            if "nothing of the bag can be read" in str(error) and told_at_start:
                return "killed while it made its bag"
            raise
    record: Record = read_bag(bag)
    steps = record.series["rig/state"].steps
    if not (steps == range(len(steps))).all():
        raise RoundError(f"states are missing in the bag: {steps}")
    trip = f", {record.trip.reason}" if record.trip else ""
    return f"{len(steps)} steps{recovered}{trip}"


def do_round(seed: int, number: int, folder: Path) -> tuple[Plan, str]:
    """Do one round.

    Returns
    -------
    plan : Plan
        What was done.
    str
        How it went, in a line.

    Raises
    ------
    RoundError
        If something was not as it must be.
    """
    plan = Plan.of(seed, number)
    run = Run([*plan.words, "--out", "bag"], folder, f"{os.getpid()}-{number}")
    try:
        come = come_to(plan, run)
        done = come and act(plan, run)
        acted_at = time.monotonic()
        run.wait_for(lambda: False, "the end of the run")
        took = time.monotonic() - acted_at
        check_end(plan, run, done)
        check_nothing_left(plan, run)
        found = check_bag(plan, folder / "bag", any("(at step 0)" in c for c in run.complaints))
    except Exception as error:
        raise RoundError(f"{error}\nthe run showed at last:\n{run.text[-500:]}") from error
    finally:
        run.clear_away()
    late = "" if done else "; came too late" if not come else "; was refused"
    return plan, f"{found}; status {run.process.returncode}, {took:.1f} s later{late}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="number of the first round")
    arguments = parser.parse_args()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    count: Counter[str] = Counter()
    started = time.monotonic()
    for number in range(arguments.first, arguments.first + arguments.rounds):
        folder = Path(tempfile.mkdtemp(prefix="seft-round-"))
        try:
            plan, how = do_round(arguments.seed, number, folder)
        except RoundError as wrong:
            print(f"round {number}: {Plan.of(arguments.seed, number)}\nWRONG: {wrong}", flush=True)
            print(f"its folder: {folder}; again: --seed {arguments.seed} --first {number}")
            return 1
        shutil.rmtree(folder)
        print(f"{number:4} {plan}: {how}", flush=True)
        for kind in (plan.moment, plan.action, plan.pace):
            count[kind] += 1
    took = time.monotonic() - started
    print(f"{arguments.rounds} rounds in {took / 60:.1f} min, nothing wrong:")
    for kind in (*MOMENTS, *ACTIONS, *STEPS):
        print(f"  {kind:25} {count[kind]}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
