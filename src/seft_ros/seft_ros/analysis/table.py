"""A summary and a comparison for people: one table and one verdict each."""

from typing import Any

from rich.console import Group, JustifyMethod
from rich.table import Table
from rich.text import Text
from seft_msgs_py.wire.topics import LOOP_TOPICS, TARGET

from seft_ros.analysis.difference_text import difference_lines
from seft_ros.analysis.estimates import estimate_lines
from seft_ros.analysis.shown import UNITS, number
from seft_ros.analysis.title import title_of
from seft_ros.recording.record import Record

GOOD_ERROR = 0.05
"""Displacement error (nrmse) up to which a test is shown in green."""

_LEAST = 0.001  # %


def summary_table(record: Record, summary: dict[str, Any]) -> Table:
    """Tabulate how a test agrees with the exact response; the caption is its `verdict`.

    Parameters
    ----------
    record : Record
        The test.
    summary : dict
        As `seft_ros.analysis.summary.summarise` gives it.
    """
    lines = [title_of(record), _pace(summary), *_trust_lines(summary), *estimate_lines(summary)]
    title = "\n".join(lines)
    table = _table(title, verdict(summary), _colour(summary))
    for heading in ("", "peak", "exact peak", "NRMSE", "NRMSE aligned", "delay"):
        table.add_column(heading, justify="right" if heading else "left", no_wrap=True)
    _add_rows(table, summary, "")
    if len(summary["axes"]) > 1:
        for axis, part in summary["axes"].items():
            table.add_section()
            _add_rows(table, part, f"{axis} ")
    return table


def comparison_table(comparison: dict[str, Any], a: str = "a", b: str = "b") -> Group:
    """Tabulate how two records differ; the lines below say where they first do.

    Parameters
    ----------
    comparison : dict
        As `seft_ros.analysis.compare.compare` gives it.
    a, b : str
        What the records are called.
    """
    table = Table(title=f"{b} against {a}", title_justify="left", title_style="")
    headings = (f"in {a}", f"in {b}", f"not\nin {a}", f"not\nin {b}", "largest", "NRMSE")
    for heading in ("topic", *headings):
        justify: JustifyMethod = "left" if heading == "topic" else "right"
        table.add_column(heading, justify=justify, no_wrap=True)
    for topic, row in comparison["topics"].items():
        counts = [row[key] for key in ("samples_a", "samples_b", "missing_a", "missing_b")]
        largest = "-" if row["max_abs"] is None else f"{row['max_abs']:.2g} {_unit(topic, row)}"
        errors = (largest, small_percent(row["nrmse"])) if row["compared"] else ("-", "-")
        table.add_row(topic, *map(str, counts), *errors)
    first, *more = difference_lines(comparison, a, b)
    colour = "green" if comparison["identical"] else "red"
    return Group(table, Text(first, style=f"bold {colour}"), *map(Text, more))


def verdict(summary: dict[str, Any]) -> str:
    """Say how a test went, in one line."""
    trip, missed = summary["trip"], summary["missed"]
    error, aligned = (summary["displacement"][key] for key in ("nrmse", "nrmse_aligned"))
    if trip is not None:
        text = f"TRIPPED at {trip['time_s']:.3f} s (step {trip['step']}): {trip['reason']}"
    elif not summary["stable"]:
        text = "UNSTABLE: samples are not finite"
    elif summary["first_step"] is None:
        text = "NOTHING KNOWN: the record has no rig/state"
    elif not summary["complete"]:
        text = "CUT OFF: the record ends before the test did"
    elif error is not None and summary["reference_specimen"] == "simulated":
        text = f"done: displacement error {percent(error)}, {percent(aligned)} without its delay"
    elif (worst := _worst_response(summary)) is not None:
        text = (
            f"done: response to the ground motion that was tested off by {percent(worst)} at most"
        )
    else:
        text = "done, with nothing to hold it against"
    if missed:
        text += f"; {missed} of {summary['steps']} steps had no command in time"
        text += _in_a_stall(summary["timing"], missed)
    if summary["overruns"]:
        text += f"; the rig's own clock was held up {summary['overruns']} times"
    if summary["saturated"]:
        text += f"; at the end of its range: {_saturated(summary)}"
    link = summary["link"]
    if link and link["late"]:
        text += f"; {link['late']} forces came after the loop's delay and were predicted"
    lost = {topic: count for topic, count in summary["lost"].items() if count}
    if lost:
        text += f"; samples lost: {', '.join(f'{n} of {topic}' for topic, n in lost.items())}"
    return text


def _worst_response(summary: dict[str, Any]) -> float | None:
    found = summary["equivalent_motion"]
    return found and found["worst_response_nrmse"]


def _trust_lines(summary: dict[str, Any]) -> list[str]:
    """Say what tells without a model whether a test is right."""
    found, tracking, lines = summary["equivalent_motion"], summary["tracking_error"], []
    if found is not None:
        lines.append(
            "ground motion tested against the one asked for: response differs by "
            f"{percent(found['response_nrmse'])}, at worst {percent(found['worst_response_nrmse'])}"
        )
    if tracking is not None:
        lines.append(f"displacement off its target by {percent(tracking['nrmse'])}")
    return lines


def _in_a_stall(timing: dict[str, Any] | None, missed: int) -> str:
    """Say how many of the missed steps were the machine's doing, if somebody watched it."""
    stalls = timing and timing["stalls"]
    if not stalls or not stalls["missed_listed"]:
        return ""
    text = f", {stalls['missed_in_a_stall']} of them while the machine itself stood still"
    if stalls["missed_listed"] < missed:
        text += f" (of the first {stalls['missed_listed']})"
    return text


def _saturated(summary: dict[str, Any]) -> str:
    dt = 1.0 / summary["rate_hz"]
    return ", ".join(
        f"{name.replace('_', ' ')} ({row['samples']} samples from {row['first_step'] * dt:.3f} s)"
        for name, row in summary["saturated"].items()
    )


def _unit(topic: str, row: dict[str, Any]) -> str:
    """Look up the unit of the field that differs most; empty if it has no fixed one."""
    units = {t.name: dict(zip(t.quantities, t.units, strict=True)) for t in (*LOOP_TOPICS, TARGET)}
    for field, errors in row["fields"].items():
        if errors["max_abs"] == row["max_abs"] != 0:
            return units.get(topic, {}).get(field, "")
    return ""


def _colour(summary: dict[str, Any]) -> str:
    """Red: the test did not run to its end; yellow: it did, and is wrong or not as timed."""
    if not (summary["stable"] and summary["complete"]):
        return "red"
    simulated = summary["reference_specimen"] == "simulated"
    error = summary["displacement"]["nrmse"] if simulated else _worst_response(summary)
    right = error is not None and error <= GOOD_ERROR
    return "green" if right and not summary["missed"] else "yellow"


def _table(title: str, caption: str, colour: str) -> Table:
    return Table(
        title=Text(title),
        title_justify="left",
        title_style="",
        caption=Text(caption, style=f"bold {colour}"),
        caption_justify="left",
        caption_style="",
    )


def _pace(summary: dict[str, Any]) -> str:
    text = f"{summary['steps']} steps, {summary['duration_s']:g} s"
    if summary["realtime_factor"] is not None:
        text += f", in {summary['wall_s']:.3g} s ({summary['realtime_factor']:.3g} x real time)"
    return text


def _add_rows(table: Table, part: dict[str, Any], prefix: str) -> None:
    for name, (unit, scale) in UNITS.items():
        row = part[name]
        table.add_row(
            f"{prefix}{name}",
            number(row["peak"], scale, unit),
            number(row["reference_peak"], scale, unit),
            percent(row["nrmse"]),
            percent(row["nrmse_aligned"]),
            "-" if row["delay_s"] is None else f"{row['delay_s'] * 1e3:.2f} ms",
        )


def small_percent(value: float | None) -> str:
    """Show a ratio as `percent` does, but none of the far too small ones."""
    return f"<{_LEAST:g} %" if value is not None and 0 < value * 100 < _LEAST else percent(value)


def percent(value: float | None) -> str:
    """Show a ratio as a percentage of three digits; a dash where there is none."""
    if value is None:
        return "-"
    return "0 %" if value == 0 else f"{value * 100:#.3g} %".replace(". %", " %")
