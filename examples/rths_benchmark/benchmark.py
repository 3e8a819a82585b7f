"""Run the RTHS benchmark control problem (Silva et al. 2020) with seft, and compare.

    .venv/bin/python examples/rths_benchmark/benchmark.py
    .venv/bin/python examples/rths_benchmark/benchmark.py --cases 4 --perturbed 0 --json

Lets seft identify the benchmark's displacement servo, then runs the tests: each case and record
with the nominal plant, and each case with perturbed plants under the first record. Beside seft run
the benchmark's sample controller and a conventional inverse. Prints the criteria J1 to J9, with the
measured and with the true displacement; the folder gets two figures and the identified response.

Exit status 0: all tests ran. 1: a test tripped, or it was interrupted. 2: wrong input.
"""

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import track
from rths_figures import criteria_figure, histories_figure
from rths_problem import PROBLEM, ground_motion
from rths_product import identify_servo
from rths_tests import (
    CONTROLLERS,
    CRITERIA,
    SEFT,
    Outcome,
    Plan,
    plan_tests,
    run_tests,
)
from seft_msgs_py.errors import InputError, SeftError
from seft_ros.drawing.style import TextTable, json_safe, save_figure

HERE = Path(__file__).resolve().parent
PLACES = (HERE / "records", HERE.parents[2] / "shared" / "data" / "rths_benchmark")
"""Where the records are looked for: in this folder, and beside the project."""
TRUE = "true "
HISTORIES, CRITERIA_FIGURE = "histories.png", "criteria.png"


def of_criterion(outcome: Outcome, name: str) -> float:
    """Find a criterion of a test; ``true `` before its name is that of the true displacement."""
    is_true = name.startswith(TRUE)
    return (outcome.true_j if is_true else outcome.j)[name.removeprefix(TRUE)]


def rows_of_criteria() -> list[str]:
    """Name all criteria; those that the measured displacement is not part of have one value."""
    return [*CRITERIA, *(TRUE + name for name in CRITERIA[:5])]


def mean_and_worst(outcomes: Sequence[Outcome], name: str) -> tuple[float, float]:
    """Mean and worst of a criterion; NaN if a test tripped."""
    values = [of_criterion(each, name) for each in outcomes]
    return sum(values) / len(values), max(values)


def groups_of(outcomes: Sequence[Outcome]) -> dict[tuple[str, str], list[Outcome]]:
    """Sort outcomes by controller, and nominal or perturbed plants."""
    groups: dict[tuple[str, str], list[Outcome]] = {}
    for controller in CONTROLLERS:
        for plants in ("nominal", "perturbed"):
            chosen = [
                each
                for each in outcomes
                if each.controller == controller and each.test.plant.startswith(plants)
            ]
            if chosen:
                groups[controller, plants] = chosen
    return groups


def summary_table(outcomes: Sequence[Outcome]) -> TextTable:
    """Make the table of means and worst values by controller."""
    groups = groups_of(outcomes)
    headings = [
        f"{controller.replace('_', ' ')}, {len(chosen)} {plants}"
        for (controller, plants), chosen in groups.items()
    ]
    rows = []
    for name in rows_of_criteria():
        pairs = (mean_and_worst(chosen, name) for chosen in groups.values())
        unit = "ms" if name.endswith("J1") else "%"
        rows.append([f"{name} / {unit}", *(f"{mean:.3g} / {worst:.3g}" for mean, worst in pairs)])
    return TextTable(["mean / worst", *headings], rows)


def nominal_table(outcomes: Sequence[Outcome]) -> TextTable:
    """Make the table of seft's nominal tests one by one, with measured and true displacement."""
    rows = []
    for each in outcomes:
        if each.controller == SEFT and not each.test.perturbed:
            name = f"{each.test.case} {each.test.record}"
            for label, found in ((name, each.j), ("  true", each.true_j)):
                numbers = [f"{value:.2f}" for value in found.values()]
                rows.append([label, *(["trip"] * len(numbers) if each.trip else numbers)])
    return TextTable(["case, record", *CRITERIA], rows)


def summarise(outcomes: Sequence[Outcome], plan: Plan, wall_s: float) -> dict[str, Any]:
    """Summarise for ``--json``: tests of each controller, their summary, files."""

    def entry(each: Outcome) -> dict[str, Any]:
        return {
            "case": each.test.case,
            "record": each.test.record,
            "plant": each.test.plant,
            "trip": each.trip or None,
            "j": each.j,
            "true_j": each.true_j,
        }

    by_controller = {
        name: [entry(each) for each in outcomes if each.controller == name] for name in CONTROLLERS
    }
    return json_safe(
        {
            "tests": by_controller.pop(SEFT),
            **by_controller,
            "summary": [
                {
                    "controller": controller,
                    "plants": plants,
                    "tests": len(chosen),
                    "criteria": {
                        name.replace(" ", "_"): dict(
                            zip(("mean", "worst"), mean_and_worst(chosen, name), strict=True)
                        )
                        for name in rows_of_criteria()
                    },
                }
                for (controller, plants), chosen in groups_of(outcomes).items()
            ],
            "seed": plan.seed,
            "identified": str(plan.identified),
            "wall_s": wall_s,
        }
    )


def perform(words: argparse.Namespace, out: Path) -> tuple[list[Outcome], Plan]:
    """Identify the servo, run the tests with a progress bar, and draw the figures."""
    console = Console(stderr=True)
    with console.status("identifying the servo"):
        plan = Plan(words.data, identify_servo(out, words.seed), words.seed)
    tests = plan_tests(words.cases, words.records, words.perturbed)
    outcomes: list[Outcome] = []
    for found, histories in track(run_tests(tests, plan), "tests", len(tests), console=console):
        outcomes += found
        if histories is not None:
            save_figure(histories_figure(histories), out / HISTORIES)
    save_figure(criteria_figure(groups_of(outcomes), mean_and_worst), out / CRITERIA_FIGURE)
    return outcomes, plan


def command_line() -> argparse.ArgumentParser:
    """Make the parser of the command line."""
    summary, _, usage = (__doc__ or "").partition("\n\n")
    parser = argparse.ArgumentParser(
        description=summary, epilog=usage, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    cases, records = list(PROBLEM["cases"]), list(PROBLEM["records"])
    parser.add_argument("--cases", type=int, nargs="+", choices=cases, default=cases)
    parser.add_argument("--records", nargs="+", choices=records, default=records)
    parser.add_argument(
        "--perturbed", type=int, default=20, metavar="N", help="plants of each case"
    )
    parser.add_argument("--seed", type=int, default=0, help="of plants and noise")
    parser.add_argument("--data", type=Path, help="folder of the records, NAME.txt")
    parser.add_argument("--out", type=Path, default=Path("rths"), help="folder of the results, new")
    parser.add_argument("--json", action="store_true", help="print one JSON object on stdout")
    return parser


def check(words: argparse.Namespace) -> None:
    """Refuse wrong input before the work."""
    if words.perturbed < 0 or words.seed < 0:
        raise InputError("--perturbed and --seed: must be 0 or more")
    if words.data is None:
        words.data = next((place for place in PLACES if place.is_dir()), PLACES[0])
    for record in words.records:
        ground_motion(words.data, record)
    try:
        words.out.mkdir(parents=True)
    except FileExistsError:
        raise InputError(f"{words.out}: exists already; name another folder with --out") from None
    except OSError as error:
        raise InputError(f"{words.out}: {error.strerror}; name another folder with --out") from None


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; exit status as the module says."""
    words, begun = command_line().parse_args(arguments), time.monotonic()
    try:
        check(words)
        outcomes, plan = perform(words, words.out)
    except SeftError as error:
        print(f"benchmark: {error}", file=sys.stderr)
        return error.exit_status
    except KeyboardInterrupt:
        print("benchmark: interrupted; there are no results", file=sys.stderr)
        return 1
    if words.json:
        print(json.dumps(summarise(outcomes, plan, time.monotonic() - begun), allow_nan=False))
    else:
        console = Console()
        console.print(nominal_table(outcomes))
        console.print(summary_table(outcomes))
        print(f"figures and the identified response: {words.out}")
    tripped = [each for each in outcomes if each.trip]
    for each in tripped:
        test = each.test
        print(f"case {test.case}, {test.record}, {test.plant}: {each.trip}", file=sys.stderr)
    return 1 if tripped else 0


if __name__ == "__main__":
    sys.exit(main())
