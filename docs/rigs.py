"""Table of compensation.md, section Masses, oil columns and rates: run it in the project's folder.

    .venv/bin/python docs/rigs.py

Largest displacement errors in percent of the tests of a column, one number for each of `RATES`.
Each row is a rig of another mass and oil column, with all else scaled to fit the test
(src/seft_ros/test/scaled_rigs.py).
"""

import itertools
import sys

import numpy as np
from seft_ros.analysis.summary import summarise_briefly
from seft_ros.test_run.offline import BlockCache

sys.path.append("src/seft_ros/test")

from experiments_at_hand import load
from scaled_rigs import scaled_rig

RIGS = (20.0, 120.0), (52.7, 89.0), (200.0, 46.0), (800.0, 23.0), (3000.0, 12.0), (20000.0, 6.0)
"""Mass, kg, and frequency of the oil column, Hz."""
RATES = 250.0, 500.0, 1000.0, 4000.0
ERRORS = "gain_error", "dead_time_error", "oil_error"
WRONG: list[dict] = [
    dict(zip(ERRORS, signs, strict=True))
    for signs in itertools.product((-0.1, 0.1), (-0.002, 0.002), (-0.2, 0.2))
]
"""What the controller knows of the actuator: relative errors, of the dead time in s."""
YIELDS = {"kind": "bilinear"}
COLUMNS: dict[str, list[dict]] = {
    "linear": [{"hz": hz, "seed": seed} for hz in (2.0, 8.0) for seed in (1, 2)],
    "linear, actuator wrong": [{"hz": hz, **wrong} for hz in (2.0, 8.0) for wrong in WRONG],
    "bilinear, 2 Hz": [{"hz": 2.0, "seed": seed, **YIELDS} for seed in (1, 2, 3)],
    "bilinear, 8 Hz": [{"hz": 8.0, "seed": seed, **YIELDS} for seed in (1, 2, 3)],
    "the same without noise": [{"hz": 8.0, "noise": 0.0, **YIELDS}],
}


def error(cache, words):
    """Displacement error of a test; infinite if it trips."""
    experiment = load(*words, config="demo")
    found = summarise_briefly(cache.run(experiment), cache.reference(experiment))
    return np.inf if found["trip"] else found["displacement"]["nrmse"]


def largest(cache, rig, tests):
    """Write the largest error of some tests at each rate, in percent."""
    for rate in RATES:
        worst = max(error(cache, scaled_rig(*rig, rate, **test)) for test in tests)
        yield "trips" if worst == np.inf else f"{100 * worst:#.2g}".rstrip(".")


def main():
    """Print the table."""
    cache = BlockCache()
    print(f"| mass | oil column | {' | '.join(COLUMNS)} |\n|{'---|' * (2 + len(COLUMNS))}")
    for mass, oil in RIGS:
        cells = [", ".join(largest(cache, (mass, oil), tests)) for tests in COLUMNS.values()]
        print(f"| {mass:g} kg | {oil:g} Hz | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
