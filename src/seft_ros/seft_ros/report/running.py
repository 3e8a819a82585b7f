"""How the test ran: timing, what was identified on line, what the nodes told."""

from typing import Any

import numpy as np

from seft_ros.analysis.estimates import shown_unit
from seft_ros.analysis.stalls import Stalls
from seft_ros.analysis.table import percent
from seft_ros.analysis.timing import GAP
from seft_ros.drawing.style import OTHERS, SECOND
from seft_ros.page.content import Block, Cell, Mark, Plot, Section, Table, Text
from seft_ros.page.plots import bars, line, mark, plot
from seft_ros.report.numbers import Findings

_BINS = 80
_MARKS = {"ok": Mark.NONE, "warn": Mark.DOUBT, "error": Mark.BAD, "stale": Mark.BAD}


def timing_section(findings: Findings) -> Section:
    """Round trips as a histogram, missed commands, gaps by topic."""
    timing, summary = findings.timing, findings.summary
    missed, steps = summary["missed"], summary["steps"]
    commands = "unknown" if missed is None else f"{missed} of {steps}"
    if missed and steps:
        commands += f" ({percent(missed / steps)})"
    rows = [("steps without a command in time", commands)]
    if missed:
        listed = findings.record.missed_steps
        more = ", ..." if missed > len(listed) else ""
        rows.append(("these steps", ", ".join(map(str, listed)) + more))
    rows.append(("times the rig's own clock was held up", _or_unknown(summary["overruns"])))
    rows += _link_rows(summary["link"])
    if timing is None:
        why = "The offline loop has no messages that could be late."
        if findings.record.environment.get("mode") != "simulate":
            why = "The record does not say when its messages were received."
        return Section("Timing", [Table((), rows), Text(why)])
    numbers = summary["timing"]["round_trip_s"]
    if timing.stalls is not None:
        rows += _stall_rows(timing.stalls, bool(missed))
    rows += [
        (f"round trip at the rig, {key}", _milliseconds(value))
        for key, value in timing.at_the_rig_s.items()
    ]
    rows += [
        (f"round trip, as recorded, {key}", _milliseconds(value))
        for key, value in numbers.items()
        if key.startswith("p") or key == "largest"
    ]
    rows.append(("of these longer than a period", str(numbers["over_a_period"])))
    blocks: list[Block] = [Table((), rows, numbers=False)]
    trips = timing.round_trip_s * 1e3
    if len(trips):
        panel = plot("round trip / ms", "steps", log_y=True)
        counts, edges = np.histogram(trips, _BINS)
        bars(panel, edges, counts.astype(float))
        mark(panel, timing.period_s * 1e3)
        caption = (
            "From a step's state to the command that answers it, as the recorder received them, "
            "which may have to wait for its core longer than the loop does; dashed: one period."
        )
        blocks.append(Plot(panel, caption))
    if not timing.paced:
        blocks.append(Text("The rig was in lockstep: it waited for each command."))
    headings = ("topic", "median", "largest", "after step", f"longer than {GAP:g} periods")
    gaps = [
        (
            row.topic,
            _milliseconds(row.median_s),
            _milliseconds(row.largest_s),
            str(row.largest_step),
            str(row.count),
        )
        for row in timing.gaps
    ]
    blocks.append(Table(headings, gaps))
    return Section("Timing", blocks)


def _link_rows(link: dict[str, Any] | None) -> list[tuple[str, str]]:
    """Rows on the link of a test on several hosts."""
    if link is None:
        return []
    ages = ", ".join(f"{name} {steps}" for name, steps in link["age"].items())
    return [
        ("delay of the loop over the link", f"{link['loop_delay']} steps"),
        ("age of the reference forces over it, steps", ages),
        ("forces that came later, and were predicted", f"{link['late']} of {link['forces']}"),
        ("of these, forces that no prediction reached", str(link["held"])),
    ]


def estimates_section(findings: Findings) -> Section:
    """Show what the compensation method identified, over time."""
    record, estimates = findings.record, findings.record.estimates
    if estimates is None:
        return Section("Estimates", [Text("The compensation method identified nothing on line.")])
    time = estimates.steps * record.experiment.timebase.dt
    axes = record.experiment.axes
    blocks: list[Block] = []
    for row, name in enumerate(estimates.names):
        unit, scale = shown_unit(name)
        panel = plot("time / s", f"{name} / {unit}" if unit else name, height=200)
        for column, axis in enumerate(axes[: len(OTHERS)]):
            color = OTHERS[column] if len(axes) > 1 else SECOND
            label = axis if len(axes) > 1 else name
            line(panel, time, estimates.values[:, row, column] * scale, label, color=color)
        blocks.append(Plot(panel))
    return Section("Estimates", blocks)


def events_section(findings: Findings) -> Section:
    """States of the test, warnings and trips, as the nodes told them."""
    trip, events = findings.record.trip, findings.record.events
    blocks: list[Block] = []
    if trip is not None:
        text = f"tripped at step {trip.step}, {trip.time_s:.3f} s: {trip.reason}"
        blocks.append(Table((), [("interlock", Cell(text, Mark.BAD))], numbers=False))
    if events:
        rows: list[list[Any]] = [
            [f"{e.time_s:.3f} s", e.source, Cell(e.text, _MARKS.get(e.level, Mark.NONE))]
            for e in events
        ]
        blocks.append(Table(("received", "from", "what"), rows, numbers=False))
    if not blocks:
        blocks.append(Text("No trip, and the record holds no states or warnings of nodes."))
    return Section("Interlock and events", blocks)


def _stall_rows(stalls: Stalls, is_missed: bool) -> list[tuple[str, str]]:
    """Rows on the machine itself, as a bare process saw it that slept on the loop's core."""
    share = percent(stalls.count / max(stalls.beats, 1))
    text = f"{stalls.count} of {stalls.beats} wake-ups ({share}) more than "
    text += f"{_milliseconds(stalls.late_s)} late, the worst by {_milliseconds(stalls.longest_s)}"
    rows = [("the machine itself: a process that only slept", text)]
    if is_missed:
        text = f"{stalls.attributed} of the {stalls.listed} listed"
        rows.append(("missed while the machine stood still", text))
    return rows


def _milliseconds(value: float | None) -> str:
    return "-" if value is None else f"{value * 1e3:.3f} ms"


def _or_unknown(value: int | None) -> str:
    return "unknown" if value is None else str(value)
