"""The result of a study as a table and as a page."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from seft_ros.drawing import page
from seft_ros.drawing.page import Block, PageSection, Plot, Text, VerdictBox
from seft_ros.drawing.style import GOOD_ERROR, OTHERS, Cell, Mark, Texts, TextTable, number, percent
from seft_ros.study.study_results import CORRELATIONS, STUDY_QUANTILES, errors_of, strength

_HEADINGS = ("method", "mass\nratio", "test 0", *STUDY_QUANTILES, "tripped")
_CAPTION = "NRMSE of the displacement: as configured (test 0), and of the drawn tests"
_CAUSES = 6  # quantities that are listed
_CHANCE = "Up to ±{:.2f} comes about by chance alone (95 %)"


def best_results(summary: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Find the best method of each mass ratio."""
    found: dict[float, dict[str, Any]] = {}
    for result in summary["results"]:
        found.setdefault(result["mass_ratio"], result)
    return list(found.values())


def headline(result: Mapping[str, Any], summary: Mapping[str, Any]) -> str:
    """Say the result of one method at one mass ratio in one sentence."""
    lost, total, errors = result["trips"], summary["tests"], result["distribution"]["displacement"]
    ends = f"{lost['count']} of {total} tests" if lost["count"] else f"none of {total} tests"
    said = f"{_name(result)}: "
    if known := [name for name in ("p95", "p90", "median") if errors[name] is not None]:
        said += f"{100 * STUDY_QUANTILES[known[0]]:g} % of the tests are at most "
        said += f"{percent(errors[known[0]])} wrong in displacement; "
    said += f"{ends} tripped or became unstable (with 95 % confidence not more than "
    said += f"{percent(lost['interval_95'][1])} do)"
    for cause in result["causes"][:1]:
        if strength(cause) > summary["chance"]:
            said += f"; the error depends most on {cause['quantity']}, which explains "
            said += f"{percent(cause['explains'])} of it"
    return f"{said}."


def study_texts(summary: Mapping[str, Any], title: str) -> Texts:
    """Show methods and mass ratios on a terminal, and the best methods in a sentence each."""
    said = [headline(best, summary) for best in best_results(summary)]
    return [title, _table(summary), _CAPTION, *study_notes(summary), *said, ""]


def _table(summary: Mapping[str, Any]) -> TextTable:
    return TextTable(_HEADINGS, [_row(result) for result in summary["results"]], wide=True)


def study_notes(summary: Mapping[str, Any]) -> list[str]:
    """Say why methods are not possible, and which were simulated uncompiled and why."""
    notes: dict[str, dict[str, None]] = {}
    for row in summary["not_possible"]:
        reason = row["reason"].replace(f"compensation.method {row['method']}", "each")
        notes.setdefault(f"not possible: {reason}", {})[row["method"]] = None
    for result in summary["results"]:
        if reason := result["uncompiled"]:
            notes.setdefault(f"simulated uncompiled: {reason}", {})[result["method"]] = None
    return [f"{', '.join(methods)}: {note}" for note, methods in notes.items()]


def write_study(summary: Mapping[str, Any], title: str, subtitle: str, path: Path) -> None:
    """Write the page; an InputError says that it can't be written."""
    verdicts = [VerdictBox(_mark(own), headline(own, summary)) for own in best_results(summary)]
    sections = [
        PageSection("Verdict", verdicts),
        PageSection("Error", _errors(summary)),
        PageSection("What the error depends on", _dependence(summary)),
        PageSection("The worst tests", _worst(summary)),
    ]
    page.write_page(path, title, subtitle, sections)


def _name(result: Mapping[str, Any]) -> str:
    return f"{result['method']} at mass ratio {result['mass_ratio']:g}"


def _mark(result: Mapping[str, Any]) -> Mark:
    error = result["distribution"]["displacement"]["p95"]
    if result["trips"]["count"]:
        return Mark.BAD
    return Mark.GOOD if error is not None and error <= GOOD_ERROR else Mark.DOUBT


def _row(result: Mapping[str, Any]) -> list[str | Cell]:
    own, errors = result["configured"], result["distribution"]["displacement"]
    shown = _of_test(own["stable"], own["displacement"]["nrmse"]), *map(_error, errors.values())
    texts = *shown, percent(result["trips"]["share"])
    return [*_place(result), *(Cell(text, _mark(result)) for text in texts)]


def _place(result: Mapping[str, Any]) -> list[str]:
    return [result["method"], f"{result['mass_ratio']:g}"]


def _error(value: float | None) -> str:
    return "unstable" if value is None else percent(value)


def _of_test(stable: bool, error: float | None) -> str:
    return percent(error) if stable else "unstable"


def _errors(summary: Mapping[str, Any]) -> list[Block]:
    notes = "".join(f" {note}." for note in study_notes(summary))
    plots = [_distribution(best["mass_ratio"], summary) for best in best_results(summary)]
    return [_table(summary), Text(f"{_CAPTION}.{notes}"), *plots]


def _distribution(ratio: float, summary: Mapping[str, Any]) -> Plot:
    panel = page.plot("NRMSE of displacement / %", "share of the tests / %", log_x=True)
    own = [result for result in summary["results"] if result["mass_ratio"] == ratio]
    for place, result in enumerate(own):
        errors = np.sort(errors_of(result["runs"]))
        at = np.arange(1, len(errors) + 1) / len(errors)
        finite = np.isfinite(errors) & (errors > 0)
        x, y = 100 * errors[finite], 100 * at[finite]
        color, dash = OTHERS[place % len(OTHERS)], ("solid", "dashed")[place // len(OTHERS) % 2]
        page.line(panel, x, y, result["method"], color=color, dash=dash)
    page.level(panel, 95.0)
    caption = "share of the drawn tests whose error is at most that. Unstable tests are missing at"
    return Plot(panel, f"Mass ratio {ratio:g}: {caption} the top. Dashed: 95 %.")


def _dependence(summary: Mapping[str, Any]) -> list[Block]:
    chance = summary["chance"]
    text = (
        "Rank correlation (Spearman) of the displacement's error with each drawn quantity, and "
        "with its deviation from the configured value either way; the square of the larger one is "
        "the share of the differences that it explains. Unstable tests are the most "
        f"wrong. {_CHANCE.format(chance)}. The largest are listed."
    )
    causes: list[list[str | Cell]] = [
        [
            *_place(result),
            Cell(cause["quantity"], Mark.DOUBT if strength(cause) > chance else Mark.NONE),
            *(number(cause[key], form="+.2f") for key in CORRELATIONS),
            percent(cause["explains"]),
        ]
        for result in summary["results"]
        for cause in result["causes"][:_CAUSES]
    ]
    headings = ("method", "mass ratio", "quantity", "its value", "its deviation", "explains")
    blocks: list[Block] = [Text(text), TextTable(headings, causes, numbers=False, wide=True)]
    motions = [
        [*_place(result), file, str(own["tests"]), *(_error(own[name]) for name in STUDY_QUANTILES)]
        for result in summary["results"]
        for file, own in result["motions"].items()
        if len(result["motions"]) > 1
    ]
    if motions:
        by_motion = ("method", "mass ratio", "ground motion", "tests", *STUDY_QUANTILES)
        blocks.append(TextTable(by_motion, motions, numbers=False, wide=True))
    return blocks


def _worst(summary: Mapping[str, Any]) -> list[Block]:
    """List the tests with the largest errors, and how each differs most from the configured one."""
    rows, offsets = [], summary["drawn"][0]["offsets"]
    for result in summary["results"]:
        for one in result["worst"]:
            found = ((name, "+" if name in offsets else "times") for name in one["furthest"])
            differs = ", ".join(f"{name} {by} {one['furthest'][name]:.3g}" for name, by in found)
            how = one["trip"]["reason"] if one["trip"] else ""
            error = _of_test(one["stable"], one["nrmse"])
            rows.append([*_place(result), str(one["test"]), error, differs, how, one["file"]])
    headings = ("method", "mass ratio", "test", "NRMSE", "furthest from configured", "trip", "file")
    text = Text("seft simulate FILE repeats a test.")
    return [text, TextTable(headings, rows, numbers=False, wide=True)]
