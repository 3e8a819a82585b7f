"""Time of one step of the simulated rig, beside the exact linear rig in the same run."""

import statistics
import sys
import time
from pathlib import Path

import numpy as np
from seft_msgs_py.experiment import Experiment
from seft_plant_sim.parameters import TABLE
from seft_plant_sim.rig import Rig

CONFIG = Path(__file__).parent.parent / "config" / "jhu.yaml"
STEPS = 5000
ROUNDS = 5
WANTED = 250e-6  # s, of the nonlinear rig: half of what 500 Hz in real time allows a rig

LINEAR = [("rig", "actuator.kind", "servo_hydraulic_linear")]
BOUC_WEN = [("rig", "specimen.kind", "bouc_wen"), ("rig", "specimen.yield_displacement", 0.002)]
FILTERED = [("rig", "sensors.anti_alias", 200.0), ("rig", "sensors.velocity", "derived")]
CASES = {
    "linear": LINEAR,
    "nonlinear": [],
    "nonlinear, Bouc-Wen": BOUC_WEN,
    "nonlinear, Bouc-Wen, filtered": BOUC_WEN + FILTERED,
    "nonlinear, 3 axes": [("/**", "axes", ["x", "y", "z"])],
    "nonlinear, 10 axes": [("/**", "axes", [f"x{i}" for i in range(10)])],
}


def step_times(rig: Rig, drives: np.ndarray) -> list[float]:
    """Seconds of each step under a valve drive."""
    rig.reset()
    found = []
    for drive in drives:
        start = time.perf_counter()
        rig.step(drive)
        found.append(time.perf_counter() - start)
    return found


def main() -> int:
    rigs, drives, times = {}, {}, {case: [] for case in CASES}
    for case, overrides in CASES.items():
        experiment = Experiment.load([TABLE], [CONFIG], overrides, nodes=["rig"])
        rigs[case] = Rig.from_parameters(experiment["rig"], experiment.axes, experiment.timebase)
        drives[case] = np.random.default_rng(1).normal(0, 2, (STEPS, len(experiment.axes)))
    for _ in range(ROUNDS):  # interleaved: the machine's speed drifts
        for case in CASES:
            times[case] += step_times(rigs[case], drives[case])
    medians = {case: statistics.median(found) for case, found in times.items()}
    print(f"{'step of the rig':32s} {'median':>9s} {'99 %':>9s}   over linear")
    for case, found in times.items():
        slow = float(np.quantile(found, 0.99))
        ratio = medians[case] / medians["linear"]
        print(f"{case:32s} {medians[case] * 1e6:6.0f} us {slow * 1e6:6.0f} us   {ratio:5.1f} times")
    slowest = max(medians[case] for case in CASES if "axes" not in case)
    print(f"wanted: one axis within {WANTED * 1e6:.0f} us")
    return 0 if slowest <= WANTED else 1


if __name__ == "__main__":
    sys.exit(main())
