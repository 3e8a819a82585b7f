"""Time of a preflight's maps, beside bare eigenvalues of as many matrices of the loop's size.

The loops' exact eigenvalues, over mass ratio and dead time, and over mass ratio and local
stiffness, on one processor.
"""

import sys
import time
from pathlib import Path

import numpy as np
from seft_msgs_py.config.experiment import Experiment
from seft_ros.design.planned_tests import PlannedTest
from seft_ros.design.stability_map import stability_maps
from seft_ros.design.stability_margins import find_margins
from seft_ros.test_run.parameter_tables import TABLES

FOLDER = Path(__file__).parent.parent / "config"
ROUNDS = 3
WANTED = 10.0  # s for both maps
WANTED_RATIO = 3.0  # of the bare eigenvalues' time, on slow and busy machines
CASES = {
    "jhu.yaml, none": ("jhu.yaml", []),
    "demo.yaml, target_motion": ("demo.yaml", []),
    "three_storey_frame.yaml": ("three_storey_frame.yaml", []),
}


def main() -> int:
    met = True
    for name, (config, overrides) in CASES.items():
        test = PlannedTest(Experiment.load(TABLES, [FOLDER / config], overrides))
        margins = find_margins(test)
        loops = test.loops()
        taken = bare = np.inf
        for _ in range(ROUNDS):  # interleaved: the machine's speed drifts
            start = time.perf_counter()
            maps = stability_maps(test, margins)
            taken = min(taken, time.perf_counter() - start)
            places = sum(area.growth.size for area in maps)
            start = time.perf_counter()
            for _ in range(100):
                for loop in loops:
                    np.linalg.eigvals(loop.matrix)
            bare = min(bare, (time.perf_counter() - start) / 100 * places)
        met &= taken <= WANTED or taken <= WANTED_RATIO * bare
        print(
            f"{name:26s} {places:5d} places {taken:6.2f} s, {taken / bare:5.2f} times the bare "
            f"eigenvalues' {bare:.2f} s"
        )
    print(f"wanted: {WANTED:g} s, or {WANTED_RATIO:g} times the bare ones' (slow, busy machines)")
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
