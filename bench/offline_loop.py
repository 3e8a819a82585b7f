"""Steps per second of the offline loop (`seft simulate`), beside two floors.

A bare loop of plain floats, and scipy's `dlsim` over the same linear closed loop: its matrix from
preflight, the whole record in one call, without noise, limits, interlock or recording. All by
processor time, and the least disturbed round counts: so other programs matter little.
"""

import sys
import time
from pathlib import Path

import numpy as np
from _plain_loop import steps_per_second as plain_steps_per_second
from scipy.signal import dlsim
from seft_msgs_py.config.experiment import Experiment
from seft_ros.design.planned_tests import PlannedTest
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.offline import simulate_test
from seft_ros.test_run.parameter_tables import TABLES

ROUNDS = 7
FOLDER = Path(__file__).parent.parent / "config"
COMMON = [
    ("reference_force", "mass_ratio", 0.5),
    ("ground_motion", "synthetic.duration", 120.0),
]
LINEAR = [("/**", "actuator.kind", "servo_hydraulic_linear")]
CASES = {  # configuration, overrides -> speed wanted, over that of the bare loop
    "linear rig": ("jhu.yaml", LINEAR, 1.4),
    "nonlinear rig": ("jhu.yaml", [], 0.9),
    "the same, target_motion": ("demo.yaml", [], 0.3),
}


def scipy_steps_per_second(experiment: Experiment, motion: list[float]) -> float:
    """Run the linear closed loop of an experiment through scipy."""
    loop, dt = PlannedTest(experiment).loops()[0], experiment.timebase.dt
    direct = np.zeros((1, loop.ground.shape[1]))
    system = loop.matrix, loop.ground, loop.displacement, direct, dt
    start = time.process_time()
    dlsim(system, np.array(motion))
    return len(motion) / (time.process_time() - start)


def main() -> int:
    blocks, experiments = {}, {}
    for kind, (name, overrides, _) in CASES.items():
        experiments[kind] = Experiment.load(TABLES, [FOLDER / name], [*COMMON, *overrides])
        blocks[kind] = build_blocks(experiments[kind])
    motion = next(iter(blocks.values())).ground_motion.samples[:, 0].tolist()
    ours: dict[str, list[float]] = {kind: [] for kind in CASES}
    floor, by_scipy = [], []
    for _ in range(ROUNDS):  # interleaved: the machine's speed drifts
        for kind in CASES:
            start = time.process_time()
            simulate_test(experiments[kind], blocks[kind], compiles=True)
            ours[kind].append(len(motion) / (time.process_time() - start))
        start = time.process_time()
        plain_steps_per_second(4 * motion)  # so long that its beginning counts for nothing
        floor.append(4 * len(motion) / (time.process_time() - start))
        by_scipy.append(scipy_steps_per_second(experiments["linear rig"], motion))
    bare = max(floor)  # of all rounds the least disturbed one, as timeit does
    met = True
    for kind, (_, _, wanted) in CASES.items():
        speed = max(ours[kind])
        met &= speed >= wanted * bare
        share = f"{speed / bare:.2f} of plain floats (wanted: {wanted:g})"
        print(f"offline loop, {kind:24s} {speed:12,.0f} steps/s, {share}")
    print(f"{'bare linear loop of plain floats':38s} {bare:12,.0f}")
    print(f"{'scipy.signal.dlsim, linear loop':38s} {max(by_scipy):12,.0f}")
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
