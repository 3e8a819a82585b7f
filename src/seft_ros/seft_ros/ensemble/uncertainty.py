"""How wrong a test may be if rig, specimen and ground motion are not exactly those configured."""

import math
import pickle
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.plotting import figure
from rich.table import Table as TerminalTable
from scipy.stats import binomtest, rankdata
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.parameter_table import Section
from seft_msgs_py.wire.topics import Timebase
from seft_plant_sim.rig import Rig

from seft_ros.drawing.page import (
    Block,
    Cell,
    Grid,
    Plot,
    Table,
    Text,
    Verdict,
    dots,
    level,
    line,
    mark,
    plot,
    write_page,
)
from seft_ros.drawing.page import Section as PageSection
from seft_ros.drawing.style import (
    GOOD_ERROR,
    MARK,
    OTHERS,
    RESPONSES,
    Mark,
    json_safe,
    make_table,
    number,
    percent,
)
from seft_ros.ensemble.entries import UNCERTAINTY, check_rig, draw_factors, perturbed_rig
from seft_ros.ensemble.runs import Run, Test
from seft_ros.ground_motion.ground_motion_block import GroundMotion
from seft_ros.test_run.compiled_loop import build_blocks

MOTION_UNCERTAINTY = {
    "peak_force": 1.0,
    "influence": 1.0,  # in place of peak_force where the motion is as recorded
    "synthetic.ground_frequency": 3.0,
    "synthetic.ground_damping": 3.0,
}
"""How uncertain each parameter of a ground motion is, in units of the spread."""

SHARES = {"median": 0.5, "p90": 0.9, "p95": 0.95, "worst": 1.0}
"""Of the tests, with errors up to a number of this name."""

CORRELATIONS = ("value", "deviation")

_Z95 = 1.959964  # of the normal distribution: 95 % are within


@dataclass(frozen=True)
class Uncertainty:
    """Tests that differ at random.

    Attributes
    ----------
    experiments : tuple of Experiment
        The configured one, then N drawn ones.
    factors : dict
        Drawn quantity -> its values over the configured one, shape (N,).
    """

    experiments: tuple[Experiment, ...]
    factors: dict[str, Floats]

    def tests(self) -> list[Test]:
        """List the tests for `seft_ros.ensemble.runs.run_tests`."""
        return [(f"test {number}", one) for number, one in enumerate(self.experiments)]


def draw_tests(
    experiment: Experiment,
    number: int,
    *,
    seed: int = 1,
    spread: float = 0.1,
    motions: Sequence[str] = (),
) -> Uncertainty:
    """Draw rigs, as `perturbed_rig` does, and ground motions.

    Each test depends on the seed and its own number alone. What the methods assume stays as
    configured.

    Parameters
    ----------
    experiment : Experiment
        As configured.
    number : int
        How many are drawn, N.
    seed, spread : int, float
        See `perturbed_rig` and `drawn_motion`.
    motions : sequence of str
        Files, of which each test takes one at random; none: the configured motion.

    Raises
    ------
    InputError
        If a drawn rig or a motion is impossible.
    """
    axes, timebase = experiment.axes, experiment.timebase
    build_blocks(experiment)
    own = experiment["ground_motion"]
    for file in dict.fromkeys(motions):
        GroundMotion.from_parameters(own | {"file": file}, axes, timebase)
    drawn = []
    for index in range(1 + number):
        rig = perturbed_rig(experiment["rig"], axes, seed, index, spread)
        check_rig(rig, axes, timebase, index)
        motion = drawn_motion(own, seed, index, spread, motions)
        drawn.append(Experiment(experiment.sections | {"rig": rig, "ground_motion": motion}))
    factors: dict[str, Floats] = {}
    # without spread: the configured values, for each axis where the drawn ones are
    base = perturbed_rig(experiment["rig"], axes, seed, 1, 0.0)
    for name in UNCERTAINTY:
        for label, place in _effective(base, name, axes, timebase):
            values = [np.ravel(one["rig"][name])[place] for one in drawn[1:]]
            factors[label] = np.array(values) / np.ravel(base[name])[place]
    for name in MOTION_UNCERTAINTY:
        values = [np.ravel(one["ground_motion"][name])[0] for one in drawn[1:]]
        nominal = np.ravel(own[name])[0]
        if any(value != nominal for value in values):
            label = "amplitude" if name in ("peak_force", "influence") else name
            factors[f"ground motion: {label}"] = np.array(values) / nominal
    return Uncertainty(tuple(drawn), factors)


def drawn_motion(
    section: Section, seed: int, number: int, spread: float, files: Sequence[str]
) -> Section:
    """Draw a ground motion; number 0 is the configured one.

    Amplitude and, of a synthetic motion, the ground layer (`MOTION_UNCERTAINTY`) and the seed;
    otherwise one of the files.
    """
    if number == 0:
        return dict(section)
    # a child of the sequence from which the rig of this number is drawn
    (child,) = np.random.SeedSequence([seed, number]).spawn(1)
    random = np.random.default_rng(child)
    drawn: Section = {}
    if files:
        drawn["file"] = files[int(random.integers(len(files)))]
    drawn["synthetic.seed"] = int(random.integers(2**31))
    amplitude = "peak_force" if section["peak_force"] else "influence"
    synthetic = not (files or section["file"])
    for name, uncertainty in MOTION_UNCERTAINTY.items():
        by = float(draw_factors(random, uncertainty, spread, 1)[0])
        if name == amplitude or (synthetic and name.startswith("synthetic.")):
            drawn[name] = np.multiply(section[name], by).tolist()
    return section | drawn


def _effective(
    base: Section, name: str, axes: tuple[str, ...], timebase: Timebase
) -> list[tuple[str, int]]:
    """Labels and places of the values of a parameter on which the simulated rig depends."""

    def simulated(section: Section) -> bytes:
        return pickle.dumps(Rig.from_parameters(section, axes, timebase).parameters)

    if simulated(base | {name: np.multiply(base[name], 1.01).tolist()}) == simulated(base):
        return []
    values = np.ravel(base[name])
    if len(axes) > 1 and name.startswith("actuator.") and len(values) == len(axes):
        return [(f"{name}, axis {axis}", n) for n, axis in enumerate(axes) if values[n]]
    return [(name, int(np.abs(values).argmax()))]


def summarise_uncertainty(plan: Uncertainty, runs: Sequence[Run]) -> dict[str, Any]:
    """Summarise the tests: ``seft uncertainty --json``.

    Parameters
    ----------
    plan : Uncertainty
        N drawn tests.
    runs : sequence of Run
        Of all its tests.

    Returns
    -------
    dict
        ``tests`` (N), ``unstable`` (count, share and its 95 % interval by Wilson 1927),
        ``configured`` (of the configured test, as of ``runs``), ``nrmse`` and ``peak_error`` of
        displacement, acceleration and force (`SHARES`; an unstable test counts as infinitely
        wrong, and what is not finite is None), ``sensitivity`` (see there), ``chance`` (rank
        correlations up to this come about by chance alone, 95 %), and ``runs`` (number, factors,
        engine, the test's summary).
    """
    drawn = runs[1:]
    lost = sum(not run.stable for run in drawn)
    errors = errors_of(drawn)
    found: dict[str, Any] = json_safe(
        {
            "tests": len(drawn),
            "unstable": {
                "count": lost,
                "share": lost / len(drawn),
                "interval_95": binomtest(lost, len(drawn)).proportion_ci(method="wilson"),
            },
            "configured": {"engine": runs[0].engine} | runs[0].summary,
            "nrmse": {name: quantiles(errors_of(drawn, name)) for name in RESPONSES},
            "peak_error": {name: quantiles(_peak_errors(drawn, name)) for name in RESPONSES},
            "sensitivity": sensitivity(plan, errors),
            "chance": _Z95 / math.sqrt(max(len(drawn) - 1, 1)),
            "runs": [
                {
                    "number": 1 + index,
                    "factors": {name: float(own[index]) for name, own in plan.factors.items()},
                    "engine": run.engine,
                }
                | run.summary
                for index, run in enumerate(drawn)
            ],
        }
    )
    return found


def errors_of(runs: Sequence[Run], quantity: str = "displacement") -> Floats:
    """NRMSE of each test; infinite where it was unstable, NaN where it is undefined."""
    values = [run.summary[quantity]["nrmse"] if run.stable else math.inf for run in runs]
    return np.array(values, dtype=float)


def _peak_errors(runs: Sequence[Run], quantity: str) -> Floats:
    """Magnitude of (peak - exact peak) / exact peak of each test, likewise."""
    found = []
    for run in runs:
        peak, exact = (run.summary[quantity][key] for key in ("peak", "reference_peak"))
        found.append(abs(peak / exact - 1.0) if exact and run.stable else math.inf)
    return np.array(found)


def quantiles(errors: Floats) -> dict[str, float]:
    """Smallest errors that so many of the tests do not exceed, see `SHARES`."""
    known = np.sort(errors[~np.isnan(errors)])
    if not len(known):
        return dict.fromkeys(SHARES, math.nan)
    places = {name: math.ceil(share * len(known)) - 1 for name, share in SHARES.items()}
    return {name: float(known[max(place, 0)]) for name, place in places.items()}


def sensitivity(plan: Uncertainty, errors: Floats) -> list[dict[str, Any]]:
    """Rank correlations (Spearman) of the error with each drawn quantity, largest first.

    With its value, and with how far that is from the configured one either way (`CORRELATIONS`).
    Unstable tests are the most wrong. NaN where all errors are equal.
    """
    known = ~np.isnan(errors)
    found = []
    for name, values in plan.factors.items():
        both = values[known], np.abs(np.log(values[known]))
        pairs = zip(CORRELATIONS, both, strict=True)
        found.append({"quantity": name, **{key: _spearman(x, errors[known]) for key, x in pairs}})
    return sorted(found, key=strength, reverse=True)


def strength(row: dict[str, Any]) -> float:
    """Magnitude of the larger of both correlations; 0 where there is none."""
    values = [row[key] for key in CORRELATIONS if row[key] is not None]
    return max((abs(value) for value in values if math.isfinite(value)), default=0.0)


def _spearman(x: Floats, y: Floats) -> float:
    """Correlation of the ranks; that of scipy cannot rank what is infinite."""
    ranks = rankdata(x), rankdata(y)
    if not len(x) or any(np.ptp(rank) == 0 for rank in ranks):
        return math.nan
    return float(np.corrcoef(*ranks)[0, 1])


def of_files(runs: Sequence[Run], plan: Uncertainty) -> list[tuple[str, list[Run]]]:
    """Group drawn tests by the file of their ground motion; none where there is one alone."""
    groups: dict[str, list[Run]] = {}
    for run, experiment in zip(runs[1:], plan.experiments[1:], strict=True):
        file = experiment["ground_motion"]["file"]
        groups.setdefault(Path(file).name, []).append(run)
    return sorted(groups.items()) if len(groups) > 1 else []


_SCATTERED = 6  # quantities whose tests are drawn
_WORST = 10  # tests that are listed
_CORRELATED = ("its value", "its deviation")
CHANCE = "Up to ±{:.2f} comes about by chance alone (95 %)"


def headline(summary: dict[str, Any]) -> str:
    """Say the result in one sentence."""
    lost, total, error = summary["unstable"], summary["tests"], summary["nrmse"]["displacement"]
    high = percent(lost["interval_95"][1])
    ends = f"{lost['count']} of {total} tests" if lost["count"] else f"none of {total} tests"
    wrong = f"at most {percent(error['p95'])} wrong" if error["p95"] is not None else "unstable"
    return (
        f"95 % of the tests are {wrong} in displacement; {ends} tripped or became unstable "
        f"(with 95 % confidence not more than {high} do)"
    )


def uncertainty_tables(summary: dict[str, Any], title: str) -> list[TerminalTable]:
    """Tabulate errors and sensitivity for a terminal."""
    headings = ("NRMSE", "configured", *SHARES)
    errors = make_table(headings, _error_rows(summary), title=title)
    chance = CHANCE.format(summary["chance"])
    rows = [(row["quantity"], *_signed(row)) for row in summary["sensitivity"]]
    by = ("rank correlation of\ndisplacement error with", *_CORRELATED)
    return [errors, make_table(by, rows, caption=chance)]


def write_uncertainty(
    summary: dict[str, Any],
    plan: Uncertainty,
    runs: Sequence[Run],
    name: str,
    drawn: str,
    path: Path,
) -> None:
    """Write the page of the tests of a configuration of this name; ``drawn`` says how they differ.

    An InputError says that it can't be written.
    """
    sections = [
        PageSection("Verdict", [Verdict(_mark(summary), f"{headline(summary)}.")]),
        PageSection("Error", _errors(summary, runs)),
        PageSection("What the error depends on", _dependence(summary, plan, runs)),
        PageSection("The worst tests", [_worst(summary)]),
    ]
    write_page(path, f"Uncertainty of {name}", drawn, sections)


def _mark(summary: dict[str, Any]) -> Mark:
    error = summary["nrmse"]["displacement"]["p95"]
    if summary["unstable"]["count"]:
        return Mark.BAD
    return Mark.GOOD if error is not None and error <= GOOD_ERROR else Mark.DOUBT


def _error_rows(summary: dict[str, Any]) -> list[list[str]]:
    own, peaks = summary["configured"], summary["peak_error"]["displacement"]
    rows = []
    for name in RESPONSES:
        configured = _error(own[name]["nrmse"] if own["stable"] else None)
        rows.append([name, configured, *map(_error, summary["nrmse"][name].values())])
    return [*rows, ["peak displacement", "", *map(_error, peaks.values())]]


def _error(value: float | None) -> str:
    return "unstable" if value is None or not math.isfinite(value) else percent(value)


def _signed(row: dict[str, Any]) -> list[str]:
    return [number(row[key], form="+.2f") for key in CORRELATIONS]


def _errors(summary: dict[str, Any], runs: Sequence[Run]) -> list[Block]:
    panel = plot("NRMSE / %", "share of the tests / %", log_x=True)
    for name, color in zip(RESPONSES, OTHERS, strict=False):
        errors = np.sort(errors_of(runs[1:], name))
        at = np.arange(1, len(errors) + 1) / len(errors)
        finite = np.isfinite(errors) & (errors > 0)
        line(panel, 100 * errors[finite], 100 * at[finite], name, color=color)
    level(panel, 95.0)
    own = runs[0].nrmse
    if own:
        mark(panel, 100 * own)
    caption = (
        "Share of the drawn tests whose error is at most that. Unstable tests are missing at the "
        "top. Dashed: 95 %, and the displacement's error of the configured test."
    )
    rows = _error_rows(summary)
    return [Table(("NRMSE", "configured", *SHARES), rows), Plot(panel, caption)]


def _dependence(summary: dict[str, Any], plan: Uncertainty, runs: Sequence[Run]) -> list[Block]:
    found, chance = summary["sensitivity"], summary["chance"]
    text = (
        "Rank correlation (Spearman) of the displacement's error with each drawn quantity, and "
        "with its deviation from the configured value either way; unstable tests are the most "
        "wrong. "
        f"{CHANCE.format(chance)}."
    )
    rows: list[list[str | Cell]] = [
        [Cell(row["quantity"], Mark.DOUBT if strength(row) > chance else Mark.NONE), *_signed(row)]
        for row in found
    ]
    blocks: list[Block] = [Text(text), Table(("quantity", *_CORRELATED), rows)]
    files = of_files(runs, plan)
    if files:
        table = [
            [name, str(len(own)), *map(_error, quantiles(errors_of(own)).values())]
            for name, own in files
        ]
        blocks.append(Table(("ground motion", "tests", *SHARES), table))
    names = [row["quantity"] for row in found[:_SCATTERED]]
    blocks.append(Grid([_scatter(name, plan, runs) for name in names], columns=3))
    return blocks


def _scatter(name: str, plan: Uncertainty, runs: Sequence[Run]) -> Plot:
    errors, values = errors_of(runs[1:]), plan.factors[name]
    panel: figure = plot(
        f"{name}, over the configured value", "NRMSE of displacement / %", log_y=True, height=230
    )
    stable = np.isfinite(errors) & (errors > 0)
    dots(panel, values[stable], 100 * errors[stable])
    lost = np.isinf(errors)
    if lost.any():
        top = float(100 * errors[stable].max()) if stable.any() else 100.0
        dots(panel, values[lost], np.full(lost.sum(), 1.5 * top), "unstable", color=MARK)
    return Plot(panel)


def _worst(summary: dict[str, Any]) -> Table:
    """List the tests with the largest errors, and how each differs most from the configured one."""

    def badness(run: dict[str, Any]) -> float:
        error = run["displacement"]["nrmse"]
        return math.inf if not run["stable"] or error is None else error

    rows = []
    for run in sorted(summary["runs"], key=badness, reverse=True)[:_WORST]:
        error = percent(run["displacement"]["nrmse"]) if run["stable"] else "unstable"
        trip = run["trip"]
        how = trip["reason"] if trip else "" if run["stable"] else "not finite"
        furthest = sorted(run["factors"].items(), key=lambda one: -abs(math.log(one[1])))[:3]
        differs = ", ".join(f"{name} times {value:.3g}" for name, value in furthest)
        rows.append([str(run["number"]), error, differs, how])
    return Table(("test", "NRMSE", "furthest from configured", "trip"), rows, False, wide=True)
