"""Steps per second of the tests of a study, beside two loops on one core.

Whole tests: 96 drawn rigs with their noise and trips, on all cores; what is made of each is its
peak displacement. One loop is bare plain floats. The other is OpenSees, the peer, where
openseespy can be imported (it is no dependency): the elastic whole structure of one axis, without
rig or control, a step and its response at a time. All run in the same rounds.
"""

import os
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import seft_msgs_py  # noqa: F401  isort: skip, first: it has numpy use one thread
import numpy as np
from _plain_loop import steps_per_second as plain_steps_per_second
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.wire.topics import RIG_STATE
from seft_ros.study.drawn_tests import draw_tests
from seft_ros.test_run.offline import BlockCache
from seft_ros.test_run.parameter_tables import TABLES

try:
    import openseespy.opensees as ops
except (ImportError, RuntimeError):
    ops = None

FOLDER = Path(__file__).parent.parent / "config"
ROUNDS = 5
TESTS = 96
PIECE = 4  # tests on one thread at a time: short enough to be left alone by others
PEER = "OpenSees, per-step loop"
COMMON = [("reference_force", "mass_ratio", 0.5)]
LINEAR = [("/**", "actuator.kind", "servo_hydraulic_linear")]
YIELDS = [
    ("rig", "simulated.specimen.kind", "bouc_wen"),
    ("rig", "simulated.specimen.yield_displacement", 0.003),
]
CASES = {  # configuration, overrides, steps/s wanted over those of OpenSees; 0: none
    "linear servo-hydraulic rig": ("jhu.yaml", [*COMMON, *LINEAR], 6.0),
    "nonlinear servo-hydraulic rig": ("jhu.yaml", COMMON, 0.0),
    "the same, Bouc-Wen specimen": ("jhu.yaml", [*COMMON, *YIELDS], 0.0),
    "the same, target_motion": ("demo.yaml", YIELDS, 1.5),
}


def run_ensemble(experiments, reduce, workers=1):
    """Results of tests on several threads, in their order."""
    shop = BlockCache()

    def one(number, experiment):
        return reduce(number, shop.run(experiment))

    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(one, range(len(experiments)), experiments))


def opensees_steps_per_second(motion: list[float], dt: float = 0.002) -> float:
    """Run the whole structure of one axis, its displacement, velocity, acceleration read."""
    ops.wipe()
    ops.model("basic", "-ndm", 1, "-ndf", 1)
    ops.node(1, 0.0)
    ops.node(2, 0.0)
    ops.fix(1, 1)
    ops.mass(2, 1.5 * 52.7)
    ops.uniaxialMaterial("Elastic", 1, 2.11e5, 800.3)
    ops.element("zeroLength", 1, 1, 2, "-mat", 1, "-dir", 1, "-doRayleigh", 0)
    ops.timeSeries("Path", 1, "-dt", dt, "-values", *motion)
    ops.pattern("UniformExcitation", 1, 1, "-accel", 1)
    ops.constraints("Plain")
    ops.numberer("Plain")
    ops.system("ProfileSPD")
    ops.algorithm("Linear")
    ops.integrator("Newmark", 0.5, 0.25)
    ops.analysis("Transient")
    analyze, x, v, a = ops.analyze, ops.nodeDisp, ops.nodeVel, ops.nodeAccel
    start = time.perf_counter()
    for _ in motion:
        analyze(1, dt)
        x(2, 1), v(2, 1), a(2, 1)
    return len(motion) / (time.perf_counter() - start)


def main() -> int:
    workers = len(os.sched_getaffinity(0))
    ensembles, speeds, single = {}, {case: [] for case in CASES}, {case: [] for case in CASES}
    for case, (name, overrides, _) in CASES.items():
        experiment = Experiment.load(TABLES, [FOLDER / name], overrides)
        drawn = draw_tests(experiment, TESTS - 1).sections
        ensembles[case] = [
            Experiment(experiment.sections | {"rig": sections["rig"]}) for sections in drawn
        ]
    motion = BlockCache().blocks(experiment).ground_motion.samples[:, 0].tolist()

    def reduced(_: int, recording) -> tuple[int, float]:
        values = recording.series[RIG_STATE.name].values
        return len(values), float(np.abs(values[:, 0]).max())

    for experiments in ensembles.values():
        run_ensemble(experiments[:2], reduced)  # compiled, or read from the disk
    loops = {"bare linear loop, plain floats": plain_steps_per_second}
    if ops is not None:
        loops[PEER] = opensees_steps_per_second
    rounds: dict[str, list[float]] = {name: [] for name in loops}
    for _ in range(ROUNDS):  # interleaved: the machine's speed drifts
        for case, experiments in ensembles.items():
            start = time.perf_counter()
            found = run_ensemble(experiments, reduced, workers)
            speeds[case].append(sum(n for n, _ in found) / (time.perf_counter() - start))
            for first in range(0, TESTS // 4, PIECE):
                start = time.perf_counter()
                found = run_ensemble(experiments[first : first + PIECE], reduced)
                single[case].append(sum(n for n, _ in found) / (time.perf_counter() - start))
        for name, loop in loops.items():
            rounds[name].append(loop(motion * 4))
    floors = {name: max(found) for name, found in rounds.items()}  # the least disturbed rounds
    met = True
    print(f"{TESTS} tests, steps/s in all, and how many times those of each loop below (wanted)")
    print(f"{'':32s} {f'{workers} threads':>12s} {'one thread':>12s}")
    for case, found in speeds.items():
        line = f"{case:32s} {max(found):12,.0f} {max(single[case]):12,.0f}"
        for name, floor in floors.items():
            wanted = CASES[case][2] if name == PEER else 0.0
            met &= max(found) >= wanted * floor
            line += f" {max(found) / floor:7.2f}" + (f" ({wanted:g})" if wanted else "")
        print(line)
    for name, floor in floors.items():
        print(f"{name:32s} {'':12s} {floor:12,.0f}")
    if ops is None:
        print("OpenSees is not installed (openseespy): not compared")
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
