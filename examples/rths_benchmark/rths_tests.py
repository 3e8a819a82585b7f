"""The tests of the benchmark with each controller, in two processes."""

import math
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import repeat
from multiprocessing import get_context
from pathlib import Path

from rths_controllers import conventional_inverse, run_benchmark, sample_controller
from rths_problem import Motion, Plant, Structure, criteria, ground_motion
from rths_product import run_product
from seft_msgs_py.arrays import Floats

SEFT, SAMPLE, INVERSE = "seft", "sample_controller", "conventional_inverse"
CONTROLLERS = (SEFT, SAMPLE, INVERSE)
CRITERIA = tuple(f"J{number}" for number in range(1, 10))
PROCESSES = 2

Criteria = dict[str, float]
"""J1 to J9."""


@dataclass(frozen=True)
class OneTest:
    """A test of the benchmark: case, record, and number of the perturbed plant; 0: nominal."""

    case: int
    record: str
    perturbed: int

    @property
    def plant(self) -> str:
        """Name of its plant."""
        return f"perturbed {self.perturbed}" if self.perturbed else "nominal"


@dataclass(frozen=True)
class Outcome:
    """Criteria of a test with one controller.

    Attributes
    ----------
    test : OneTest
        The test.
    controller : str
        One of `CONTROLLERS`.
    j, true_j : dict
        With measured and with true displacement of the specimen; NaN for a test that tripped.
    trip : str
        Why it ended early; empty if it did not.
    """

    test: OneTest
    controller: str
    j: Criteria
    true_j: Criteria
    trip: str


@dataclass(frozen=True)
class Histories:
    """Motions of a test by controller, and displacements of the whole frame, shape (N, 3), m."""

    test: OneTest
    motions: dict[str, Motion]
    reference: Floats


@dataclass(frozen=True)
class Plan:
    """What all tests share.

    Attributes
    ----------
    data, identified : Path
        Folder of the records; parameter file with what was identified on the nominal plant.
    seed : int
        Of the perturbed plants, and of the noise.
    """

    data: Path
    identified: Path
    seed: int


def plan_tests(cases: Sequence[int], records: Sequence[str], perturbed: int) -> list[OneTest]:
    """List the tests: nominal ones for each case and record, perturbed ones for each case.

    Those have the first record.
    """
    nominal = [OneTest(case, record, 0) for case in cases for record in records]
    drawn = range(1, 1 + perturbed)
    return nominal + [OneTest(case, records[0], number) for case in cases for number in drawn]


def run_test(test: OneTest, plan: Plan) -> Histories:
    """Run a test with each controller, which knows the nominal plant at most."""
    ground, known = ground_motion(plan.data, test.record), Plant.nominal()
    plant = Plant.perturbed(test.perturbed, plan.seed) if test.perturbed else known
    structure, seed = Structure(test.case, plant), plan.seed + test.perturbed
    motions = {
        SEFT: run_product(structure, plant, plan.identified, ground, seed),
        SAMPLE: run_benchmark(structure, plant, sample_controller(), ground, seed),
        INVERSE: run_benchmark(structure, plant, conventional_inverse(known), ground, seed),
    }
    return Histories(test, motions, structure.reference(ground))


def assess(found: Histories) -> list[Outcome]:
    """Calculate the criteria of a test with each controller."""
    outcomes = []
    for controller, motion in found.motions.items():
        j = true_j = dict.fromkeys(CRITERIA, math.nan)
        if not motion.trip:
            j = criteria(motion.measured, motion.numerical, found.reference)
            true_j = criteria(motion.true, motion.numerical, found.reference)
        outcomes.append(Outcome(found.test, controller, j, true_j, motion.trip))
    return outcomes


def _job(test: OneTest, plan: Plan, is_drawn: bool) -> tuple[list[Outcome], Histories | None]:
    found = run_test(test, plan)
    return assess(found), found if is_drawn else None


def run_tests(
    tests: Sequence[OneTest], plan: Plan
) -> Iterator[tuple[list[Outcome], Histories | None]]:
    """Run tests side by side, in their order; histories are those of the first one."""
    drawn = [test is tests[0] for test in tests]
    # started anew: a copy of a process with threads may stand still
    with ProcessPoolExecutor(min(PROCESSES, len(tests)), get_context("spawn")) as pool:
        yield from pool.map(_job, tests, repeat(plan), drawn)
