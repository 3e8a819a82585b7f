"""Table of protection_results.md: faults of the hardware, and a perfect detector.

Run it in the project:

    .venv/bin/python docs/faults.py kobe.txt:cm/s2:0.005:0

The limits fit each test, as seft preflight proposes them. Each fault begins while the specimen is
quiet, moves fast, and is at its peak. A perfect detector trips in the sample at which the fault
begins. The motion is FILE, or FILE:UNIT:DT:COLUMN (yours to bring; kobe.txt is Kobe 1995, JMA N-S).
"""

import sys
from collections import Counter, defaultdict
from dataclasses import replace

import numpy as np

sys.path.append("src/seft_ros/test")

from experiments_at_hand import load
from fault_free_tests import motion_words
from rig_faults import FAULTS, lines_of
from seft_msgs_py.config.facts import CHANNELS
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.offline import simulate_test
from test_detectors import (
    BILINEAR,
    IN_TIME,
    KIND,
    LARGEST,
    NOISE,
    PLAN,
    SPECIMEN,
    verdict,
)

FRICTION = (f"{KIND}friction", f"{SPECIMEN}friction.force:=60.0")
STIFF = (
    *("specimen.stiffness:=2.0e6", "specimen.damping:=1000.0"),
    "ground_motion:peak_force:=2000.0",
)
SLOW: dict[str, list[tuple[str, ...]]] = {
    "load cell late by 4, 6, 10 ms": [(f"force late {late}",) for late in (0.004, 0.006, 0.01)],
    "load cell low-passed, 5, 10 Hz": [(f"force lowpass {hertz}",) for hertz in (5, 10)],
    "load cell scaled by 0.7": [("force scale 0.7",)],
    "load cell frozen with noise": [("force freeze", "force noise 3")],
    "accelerometer late by 4, 10 ms": [(f"acceleration late {late}",) for late in (0.004, 0.01)],
    "accelerometer frozen, without and with noise": [
        ("acceleration freeze",),
        ("acceleration freeze", "acceleration noise 0.05"),
    ],
    "accelerometer low-passed, 5, 10 Hz": [(f"acceleration lowpass {hertz}",) for hertz in (5, 10)],
    "velocity or displacement late by 6 ms": [
        (f"{channel} late 0.006",) for channel in ("velocity", "displacement")
    ],
    "valve's null drifts by 0.5 V/s, either way": [("valve null 0.5",), ("valve null -0.5",)],
    "valve's hysteresis 1 V": [("valve hysteresis 1",)],
    "valve jams for 30 ms": [("valve stick",)],
    "specimen breaks, 5 % left": [("specimen break 0.05",)],
    "specimen slips by 1 mm": [("specimen slip 0.001",)],
}
BROKEN, FARTHEST = 0.2, 2.0
"""Time in which a test with a broken specimen must end, s, and its largest displacement over that
of the fault-free test."""
GROUPS = {  # of the other faults, by the beginning of their names
    **{f"{channel}: dead, frozen, flipped, ...": channel for channel in CHANNELS},
    "valve: stuck, closed, reversed, ...": "valve",
    "supply: lost, at a tenth": "supply",
    "converter, cable, all sensors": ("converter", "cable", "axes"),
}


def tests(motion):
    """Give the tests: words, configuration, and the axis that fails."""
    other = ("rate:=250.0", "ground_motion:synthetic.seed:=4", "rig:seed:=5")
    return {
        "linear": (PLAN, "jhu", ""),
        "bilinear": ((*PLAN, *BILINEAR), "jhu", ""),
        "friction": ((*PLAN, *FRICTION), "jhu", ""),
        "stiff": ((*PLAN, *STIFF), "jhu", ""),
        "three storeys": (("ground_motion:synthetic.seed:=2",), "three_storey_frame", "floor_3/"),
        "linear, 1000 Hz": ((*PLAN, "rate:=1000.0", "ground_motion:synthetic.seed:=3"), "jhu", ""),
        "bilinear, 250 Hz": ((*PLAN, *BILINEAR, *other), "jhu", ""),
        "friction, other motion": ((*PLAN, *FRICTION, *motion), "jhu", ""),
    }


class PerfectDetector:
    """Stands in for a `Rig` whose guard ends the test in the sample at which a fault begins."""

    def __init__(self, rig, at):
        self._rig, self._at = rig, at

    def __getattr__(self, name):
        return getattr(self._rig, name)

    @property
    def violation(self):
        """Why the test must end: in time."""
        return "perfect" if self._rig.step_index >= self._at else self._rig.violation

    def stop(self, *plan):
        """Close the valve, as at a fault: the plan can't be trusted."""
        return self._rig.stop(*(plan if self._rig.step_index < self._at else ()))


def fitting(words, config):
    """Give the words of the limits that fit a test, and its fault-free recording."""
    experiment = load(*words, config=config)
    recording = simulate_test(experiment, build_blocks(experiment), compiles=True)
    assert recording.trip is None, recording.trip
    peaks = np.abs(recording.states.values).max(axis=(0, 2))
    limits = [
        f"limits.{name}:={factor * peak:.6g}"
        for name, factor, peak in zip(CHANNELS, (1.5, 2.0, 2.0, 1.5), peaks, strict=True)
    ]
    return (*words, *limits), recording


def moments(recording):
    """Give the steps at which the specimen is quiet, moves fast, and is at its peak."""
    moved = recording.series["rig/state"].values[:, 0, -1]
    size = np.abs(moved)
    peak, rate = int(size.argmax()), round(1 / recording.experiment.timebase.dt)
    wide = np.convolve(moved**2, np.ones(rate // 2) / (rate // 2), "same") ** 0.5
    quiet = rate + int(np.argmax(wide[rate:] > 0.2 * wide.max()))
    fast = int(np.argmax(wide > 0.6 * wide.max()))
    return quiet, fast, peak


def faults_of(test, right):
    """Give the faults: by name, each as the parameter ``rig: faults`` without its time."""
    dt, largest = right.experiment.timebase.dt, np.abs(right.states.values)
    for name, all_of in SLOW.items():
        ends = f" for {round(0.03 / dt)}" if "30 ms" in name else ""
        yield from ((name, [(kind, ends) for kind in kinds]) for kinds in all_of)
    if test in ("linear", "friction"):
        for name, beginning in GROUPS.items():
            for fault in (one for one in FAULTS if one.startswith(beginning)):
                lines = lines_of(fault, 0.0, NOISE, largest.max(axis=(0, 2)))
                yield name, [(line.removesuffix(" at 0.0"), "") for line in lines]


def try_fault(experiment, known, right, at, name):
    """Say what came of a fault, and whether a perfect detector would have been in time."""
    blocks = build_blocks(experiment, known)
    recording = simulate_test(experiment, blocks, compiles=True)
    blocks = build_blocks(experiment, known)
    perfect = replace(blocks, rig=PerfectDetector(blocks.rig, at))
    best, fault_free = simulate_test(experiment, perfect).simulated, right.simulated
    if name.startswith("specimen breaks"):
        farthest = FARTHEST * fault_free.displacement_peak
        ended = (
            recording.trip and (recording.trip.step - at) * experiment.timebase.dt <= BROKEN + 1e-9
        )
        in_time = ended and recording.simulated.displacement_peak <= farthest
        return IN_TIME if in_time else "", best.displacement_peak <= farthest
    return verdict(
        recording, fault_free.force_peak, right
    ), best.force_peak <= LARGEST * fault_free.force_peak


def main():
    """Print the table."""
    motion = motion_words(sys.argv[1]) if len(sys.argv) > 1 else ()
    found, possible = defaultdict(Counter), Counter()
    for test, (words, config, axis) in tests(motion).items():
        given, right = fitting(words, config)
        experiment, known = load(*given, config=config), {}
        for at in moments(right):
            time = at * experiment.timebase.dt
            for name, kinds in faults_of(test, right):
                lines = [f"{axis}{kind} at {time!r}{ends}" for kind, ends in kinds]
                faulty = experiment.changed({"rig": {"faults": lines}})
                outcome, best = try_fault(faulty, known, right, at, name)
                found[name][outcome] += 1
                possible[name] += best
                print(test, f"{time:g} s", lines, outcome, best, file=sys.stderr, flush=True)
    print("| fault | tests | in time | perfect detector |\n|---|---|---|---|")
    for name, outcomes in found.items():
        print(f"| {name} | {outcomes.total()} | {outcomes[IN_TIME]} | {possible[name]} |")


if __name__ == "__main__":
    main()
