"""The page on uncertain tests: distribution of the error, and what it depends on."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.plotting import figure
from rich.table import Table as TerminalTable

from seft_ros.drawing.page import (
    Block,
    Cell,
    Grid,
    Plot,
    Section,
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
from seft_ros.drawing.style import MARK, OTHERS
from seft_ros.drawing.tables import GOOD_ERROR, RESPONSES, Mark, make_table, number, percent
from seft_ros.ensemble.runs import Run
from seft_ros.ensemble.uncertainty import (
    CORRELATIONS,
    SHARES,
    Uncertainty,
    errors_of,
    of_files,
    quantiles,
    strength,
)

_SCATTERED = 6  # quantities whose tests are drawn
_WORST = 10  # tests that are listed
_FACTOR = "over the configured value"
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
        Section("Verdict", [Verdict(_mark(summary), f"{headline(summary)}.")]),
        Section("Error", _errors(summary, runs)),
        Section("What the error depends on", _dependence(summary, plan, runs)),
        Section("The worst tests", [_worst(summary)]),
    ]
    write_page(path, f"Uncertainty of {name}", drawn, sections)


def _mark(summary: dict[str, Any]) -> Mark:
    error = summary["nrmse"]["displacement"]["p95"]
    if summary["unstable"]["count"]:
        return Mark.BAD
    return Mark.GOOD if error is not None and error <= GOOD_ERROR else Mark.DOUBT


def _error_rows(summary: dict[str, Any]) -> list[list[str]]:
    def cell(value: float | None) -> str:
        return "unstable" if value is None else percent(value)

    own = summary["configured"]
    rows = []
    for name in RESPONSES:
        configured = cell(own[name]["nrmse"] if own["stable"] else None)
        values = [cell(summary["nrmse"][name][share]) for share in SHARES]
        rows.append([name, configured, *values])
    peaks = [cell(summary["peak_error"]["displacement"][share]) for share in SHARES]
    return [*rows, ["peak displacement", "", *peaks]]


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
        table = []
        for name, own in files:
            values = quantiles(errors_of(own))
            table.append([name, str(len(own)), *(_percent(values[share]) for share in SHARES)])
        blocks.append(Table(("ground motion", "tests", *SHARES), table))
    names = [row["quantity"] for row in found[:_SCATTERED]]
    blocks.append(Grid([_scatter(name, plan, runs) for name in names], columns=3))
    return blocks


def _percent(value: float) -> str:
    return percent(value) if math.isfinite(value) else "unstable"


def _scatter(name: str, plan: Uncertainty, runs: Sequence[Run]) -> Plot:
    errors, values = errors_of(runs[1:]), plan.factors[name]
    panel: figure = plot(f"{name}, {_FACTOR}", "NRMSE of displacement / %", log_y=True, height=230)
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
        error, trip = percent(run["displacement"]["nrmse"]), run["trip"]
        how = trip["reason"] if trip else "" if run["stable"] else "not finite"
        furthest = sorted(run["factors"].items(), key=lambda one: -abs(math.log(one[1])))[:3]
        differs = ", ".join(f"{name} times {value:.3g}" for name, value in furthest)
        rows.append([str(run["number"]), error if run["stable"] else "unstable", differs, how])
    return Table(("test", "NRMSE", "furthest from configured", "trip"), rows, False, wide=True)
