"""Table of safety.md: slow faults, and what a perfect detector would reach; run in the project.

    .venv/bin/python docs/slow_faults.py kobe.txt:cm/s2:0.005:0

The limits fit each test, as seft preflight proposes them. A perfect detector trips in the sample
at which the fault begins. Each fault begins while the specimen is quiet, moves fast, and is at its
peak.
"""

import sys
from collections import Counter, defaultdict
from dataclasses import replace

import numpy as np

sys.path.append("src/seft_ros/test")

from experiments_at_hand import load
from rig_faults import CHANNELS
from seft_plant_sim.rig import Rig
from seft_ros.test_run.compiled_loop import build_blocks
from seft_ros.test_run.offline import simulate_test
from sound_tests import motion_words
from test_detectors import BILINEAR, KIND, PLAN, SPECIMEN

FRICTION = (f"{KIND}friction", f"{SPECIMEN}friction.force:=60.0")
STIFF = (
    *(f"{SPECIMEN}stiffness:=2.0e6", "reference_force:model.stiffness:=2.0e6"),
    *(f"{SPECIMEN}damping:=1000.0", "reference_force:model.damping:=1000.0"),
    *("rig:actuator.oil_column_frequency:=0.0", "rig:actuator.oil_stiffness:=1.664e+7"),
    "ground_motion:peak_force:=2000.0",
)
FRAME, UPPER = "three_storey_frame", "floor_3/"
SOON, LARGEST, BROKEN = 0.05, 1.5, 0.2
FAULTS = {
    "load cell late by 4 ms": "force late 0.004",
    "load cell late by 6 ms": "force late 0.006",
    "load cell late by 10 ms": "force late 0.01",
    "load cell low-passed, 5 Hz": "force lowpass 5",
    "load cell low-passed, 10 Hz": "force lowpass 10",
    "load cell scaled by 0.7": "force scale 0.7",
    "load cell frozen with noise": ("force freeze", "force noise 3"),
    "accelerometer late by 4 ms": "acceleration late 0.004",
    "accelerometer late by 10 ms": "acceleration late 0.01",
    "accelerometer frozen": "acceleration freeze",
    "accelerometer frozen with noise": ("acceleration freeze", "acceleration noise 0.05"),
    "accelerometer low-passed, 5 Hz": "acceleration lowpass 5",
    "accelerometer low-passed, 10 Hz": "acceleration lowpass 10",
    "velocity late by 6 ms": "velocity late 0.006",
    "displacement late by 6 ms": "displacement late 0.006",
    "valve's null drifts by 0.5 V/s": "valve null 0.5",
    "valve's null drifts by -0.5 V/s": "valve null -0.5",
    "valve's hysteresis 1 V": "valve hysteresis 1",
    "valve jams for 30 ms": "valve stick",
    "specimen breaks, 5 % left": "specimen break 0.05",
    "specimen slips by 1 mm": "specimen slip 0.001",
}


def tests(motion):
    """Give the tests: words, configuration, and the axis that fails."""
    return {
        "linear": ((*PLAN,), "jhu", ""),
        "bilinear": ((*PLAN, *BILINEAR), "jhu", ""),
        "friction": ((*PLAN, *FRICTION), "jhu", ""),
        "stiff": ((*PLAN, *STIFF), "jhu", ""),
        "three storeys": (("ground_motion:synthetic.seed:=2",), FRAME, UPPER),
        "linear, 1000 Hz": ((*PLAN, "rate:=1000.0", "ground_motion:synthetic.seed:=3"), "jhu", ""),
        "bilinear, 250 Hz": (
            (*PLAN, *BILINEAR, "rate:=250.0", "ground_motion:synthetic.seed:=4", "rig:seed:=5"),
            *("jhu", ""),
        ),
        "friction, other motion": ((*PLAN, *FRICTION, *motion), "jhu", ""),
    }


class PerfectDetector:
    """Stands in for an `Interlock` that trips in the sample at which a fault begins."""

    def __init__(self, interlock, at):
        self._interlock, self._at = interlock, at

    def __getattr__(self, name):
        return getattr(self._interlock, name)

    def judge(self, index, raw):
        """Judge a sample; trip in time."""
        judged = self._interlock.judge(index, raw)
        if index >= self._at:
            self._interlock.trip(index, "perfect")
        return judged


def fitting(words, config):
    """Give the words of the limits that fit a test, and its sound record."""
    experiment = load(*words, config=config)
    record = simulate_test(experiment, build_blocks(experiment), compiles=True)
    assert record.trip is None, record.trip
    peaks = np.abs(record.series["rig/state"].values).max(axis=(0, 2))
    names = "displacement", "velocity", "acceleration", "force"
    limits = [
        f"supervisor:limits.{name}:={factor * peak:.6g}"
        for name, factor, peak in zip(names, (1.5, 2.0, 2.0, 1.5), peaks, strict=True)
    ]
    return (*words, *limits), record


def moments(record):
    """Give the steps at which the specimen is quiet, moves fast, and is at its peak."""
    moved = record.series["rig/state"].values[:, 0, -1]
    size = np.abs(moved)
    peak, rate = int(size.argmax()), round(1 / record.experiment.timebase.dt)
    wide = np.convolve(moved**2, np.ones(rate // 2) / (rate // 2), "same") ** 0.5
    quiet = rate + int(np.argmax(wide[rate:] > 0.2 * wide.max()))
    fast = int(np.argmax(wide > 0.6 * wide.max()))
    return {"quiet": quiet, "fast": fast, "peak": peak}


def felt_at(record, right):
    """Give the first step that a fault changes by more than noise (None: none), and true force."""
    experiment = record.experiment
    faults = [
        line
        for line in experiment["rig"]["faults"]
        if not line.rpartition("/")[2].startswith(CHANNELS)
    ]
    rig = Rig.from_parameters(
        experiment["rig"] | {"faults": faults or ""}, experiment.axes, experiment.timebase
    )
    commands = record.series["valve_command"].values[:-1, 0]
    sampled = np.array([rig.reset(), *(rig.step(command) for command in commands)])
    noise = np.array([5e-6, 1e-3, 0.05, 3.0])[:, np.newaxis]
    beyond = (np.abs(record.series["rig/state"].values - sampled) > 6.0 * noise).any(axis=(1, 2))
    if not beyond.any():
        sound = right.series["rig/state"].values[: len(sampled)]
        beyond = (np.abs(sampled - sound) > 6.0 * noise).any(axis=(1, 2))
    return int(beyond.argmax()) if beyond.any() else None, np.abs(sampled[:, 3]).max()


def lines_of(fault, axis, at, dt):
    """Give a fault as the parameter ``rig: faults``."""
    kinds = (fault,) if isinstance(fault, str) else fault
    lasts = f" for {round(0.03 / dt)}" if "stick" in kinds[0] else ""
    return [f"{axis}{kind} at {at * dt!r}{lasts}" for kind in kinds]


def try_fault(experiment, known, right, at, name):
    """Give a test's record, the delay of its trip, and whether it was in time; of a perfect one."""
    blocks = build_blocks(experiment, known)
    record = simulate_test(experiment, blocks, compiles=True)
    blocks = build_blocks(experiment, known)
    perfect = replace(blocks, force_controller=PerfectDetector(blocks.force_controller, at))
    best = simulate_test(experiment, perfect)
    force = right.simulated.force_peak
    moved = right.simulated.displacement_peak
    (felt, before), dt = felt_at(record, right), experiment.timebase.dt
    if name.startswith("specimen breaks"):
        felt = at
    late = np.inf
    if record.trip is not None:
        late = 0.0 if felt is None else (record.trip.step - felt) * dt
    gentle = record.simulated.force_peak <= LARGEST * force
    possible = best.simulated.force_peak <= LARGEST * force
    if name.startswith("specimen breaks"):
        in_time = late <= BROKEN + 1e-9 and record.simulated.displacement_peak <= 2.0 * moved
        possible = best.simulated.displacement_peak <= 2.0 * moved
    else:
        in_time = late <= SOON + 1e-9 and gentle
    reason = record.trip.reason if record.trip else ""
    return {
        "late": late,
        "since": (record.trip.step - at) * dt if record.trip else np.inf,
        "force": record.simulated.force_peak / force,
        "moved": record.simulated.displacement_peak / moved,
        "best": best.simulated.force_peak / force,
        "in_time": bool(in_time),
        "before": before / force,
        "seen": bool(late <= SOON + 1e-9 and before <= LARGEST * force),
        "possible": bool(possible),
        "reason": reason.rsplit(": ", 1)[-1][-40:],
    }


def main():
    """Print the table."""
    motion = motion_words(sys.argv[1]) if len(sys.argv) > 1 else ()
    only = sys.argv[2:]
    found = defaultdict(list)
    for test, (words, config, axis) in tests(motion).items():
        given, right = fitting(words, config)
        experiment, known = load(*given, config=config), {}
        for moment, at in moments(right).items():
            for name, fault in FAULTS.items():
                if only and not any(one in name for one in only):
                    continue
                lines = lines_of(fault, axis, at, experiment.timebase.dt)
                faulty = experiment.changed({"rig": {"faults": lines}})
                one = try_fault(faulty, known, right, at, name)
                found[name].append(one)
                numbers = " ".join(
                    f"{one[key]:.3f}"
                    for key in ("late", "since", "before", "force", "moved", "best")
                )
                mark = ("s" if one["seen"] else "-") + (
                    "ok" if one["in_time"] else ("--" if one["possible"] else "no")
                )
                print(
                    f"{mark} {name:32} {test:22} {moment:6} {numbers} {one['reason']}",
                    file=sys.stderr,
                    flush=True,
                )
    print("| fault | in time | perfect detector | seen in time | by |\n|---|---|---|---|---|")
    for name, all_of in found.items():
        good, could, seen = (
            sum(one[key] for one in all_of) for key in ("in_time", "possible", "seen")
        )
        by = Counter(one["reason"] for one in all_of if one["in_time"]).most_common(4)
        print(f"| {name} | {good} of {len(all_of)} | {could} | {seen} | {by} |")
    for group, first in (
        ("sensors", ("load", "acc", "vel", "disp")),
        ("valve", "valve"),
        ("specimen", "specimen"),
    ):
        own = [one for name in found if name.startswith(first) for one in found[name]]
        print(
            group,
            sum(one["in_time"] for one in own),
            sum(one["possible"] for one in own),
            sum(one["seen"] for one in own),
            len(own),
        )


if __name__ == "__main__":
    main()
