"""A test's summary as a table for the terminal."""

from dataclasses import replace
from typing import Any

from rich.table import Table
from rich.text import Text

from seft_ros.analysis.judgement import verdict, worst_response
from seft_ros.drawing.tables import (
    DISPLAY_UNITS,
    GOOD_ERROR,
    RESPONSES,
    Number,
    make_table,
    number,
    percent,
)
from seft_ros.recording.record import Record

AGREEMENT = (
    Number("peak", "peak"),
    Number("reference peak", "reference_peak"),
    Number("NRMSE", "nrmse", form=percent),
    Number("NRMSE aligned", "nrmse_aligned", form=percent),
    Number("delay", "delay_s", "ms", 1e3, ".2f"),
)
"""Agreement of a quantity with its reference, by column; the peaks are in the quantity's unit."""


def agreement_rows(part: dict[str, Any], prefix: str = "") -> list[list[str]]:
    """Make a row of each measured quantity in a summary, or in the part of it on an axis."""
    rows = []
    for quantity in RESPONSES:
        unit, scale = DISPLAY_UNITS[quantity]
        peaks = [replace(column, unit=unit, scale=scale) for column in AGREEMENT[:2]]
        columns = (*peaks, *AGREEMENT[2:])
        rows.append([f"{prefix}{quantity}", *(column.text(part[quantity]) for column in columns)])
    return rows


def summary_table(record: Record, summary: dict[str, Any]) -> Table:
    """Tabulate a test's agreement with the reference response; the caption is its verdict."""
    rows: list[Any] = agreement_rows(summary)
    if len(summary["axes"]) > 1:
        for axis, part in summary["axes"].items():
            rows += [None, *agreement_rows(part, f"{axis} ")]
    return make_table(
        ["", *(column.label for column in AGREEMENT)],
        rows,
        title=Text("\n".join([title_of(record), *_lines(summary)])),
        caption=Text(verdict(summary), style=f"bold {_colour(summary)}"),
    )


def title_of(record: Record) -> str:
    """Name method, mass ratio, compensation and rate of a test in one line."""
    section = record.experiment.sections.get("reference_force", {})
    parts = [str(section.get("method", "test")).upper()]
    if "mass_ratio" in section:
        parts.append(f"mass ratio {section['mass_ratio']:g}")
    if "compensation.method" in section:
        parts.append(f"compensation {section['compensation.method']}")
    parts.append(f"{record.experiment.timebase.rate:g} Hz")
    return ", ".join(parts)


def _colour(summary: dict[str, Any]) -> str:
    """Red: the test did not run to its end; yellow: it did, and is wrong or missed deadlines."""
    if not (summary["stable"] and summary["complete"]):
        return "red"
    simulated = summary["reference_specimen"] == "simulated"
    error = summary["displacement"]["nrmse"] if simulated else worst_response(summary)
    right = error is not None and error <= GOOD_ERROR
    return "green" if right and not summary["missed"] else "yellow"


def _lines(summary: dict[str, Any]) -> list[str]:
    """Say how fast it ran, what shows without a model that it is right, what was identified."""
    pace = f"{summary['steps']} steps, {summary['duration_s']:g} s"
    if summary["realtime_factor"] is not None:
        pace += f", in {summary['wall_s']:.3g} s ({summary['realtime_factor']:.3g} x real time)"
    lines, found, tracking = [pace], summary["equivalent_motion"], summary["tracking_error"]
    if found is not None:
        lines.append(
            "tested ground motion against the one asked for: response differs by "
            f"{percent(found['response_nrmse'])}, at worst {percent(found['worst_response_nrmse'])}"
        )
    if tracking is not None:
        lines.append(f"displacement off its target by {percent(tracking['nrmse'])}")
    if summary["detectors"]:
        name, share = max(summary["detectors"].items(), key=lambda item: item[1])
        lines.append(f"detectors of faults: {name} reached {percent(share)} of its threshold")
    for name, by_axis in summary["estimates"].items():
        unit, scale = DISPLAY_UNITS.get(name, ("", 1.0))
        texts = []
        for axis, part in by_axis.items():
            first, last, least, largest = (number(part[key], scale) for key in part)
            text = f"{first} to {last} {unit}".rstrip() + f" (between {least} and {largest})"
            texts.append(f"{axis} {text}" if len(by_axis) > 1 else text)
        lines.append(f"{name} as identified: {', '.join(texts)}")
    return lines
