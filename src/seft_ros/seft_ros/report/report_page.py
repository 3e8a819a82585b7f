"""The report of a test as a page; here also what was tested, and how the test ran."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from seft_msgs_py.wire.topics import GROUND_MOTION

from seft_ros.analysis.summary_text import title_of
from seft_ros.analysis.timing import GAP
from seft_ros.bags.record import Record
from seft_ros.drawing.style import OTHERS, SECOND
from seft_ros.drawing.tables import DISPLAY_UNITS, Number, axis_label, percent, rows_of
from seft_ros.page.content import Block, Cell, Mark, Plot, Section, Table, Text, Verdict, write_page
from seft_ros.page.plots import bars, line, mark, plot
from seft_ros.report.numbers import Findings
from seft_ros.report.response_sections import (
    agreement_section,
    energy_section,
    ground_motion_section,
    history_sections,
    hysteresis_section,
    spectra_section,
    tracking_section,
)

_BINS = 80
_MARKS = {"ok": Mark.NONE, "warn": Mark.DOUBT, "error": Mark.BAD, "stale": Mark.BAD}
_SOFTWARE = ("python", "platform", "cpus")
_LINK = (
    Number("delay of the loop over the link", "loop_delay", "steps", form=str),
    Number(
        "age of the reference forces over it, steps",
        "age",
        form=lambda age: ", ".join(f"{name} {steps}" for name, steps in age.items()),
    ),
    Number(
        "forces that came later, and were predicted",
        form=lambda link: f"{link['late']} of {link['forces']}",
    ),
    Number("of these, forces that no prediction reached", "held", form=str),
)
_GAPS = (
    Number("median", "median_s", "ms", 1e3, ".3f"),
    Number("largest", "largest_s", "ms", 1e3, ".3f"),
    Number("after step", "largest_step", form=str),
    Number(f"longer than {GAP:g} periods", "count", form=str),
)


def write_report(findings: Findings, name: str, path: Path) -> None:
    """Write the page of a test of this name; an InputError says that it can't be written."""
    write_page(path, f"Test {name}", title_of(findings.record), list(_sections(findings)))


def _sections(findings: Findings) -> Iterator[Section]:
    judgement, axes = findings.judgement, findings.record.experiment.axes
    cells = [Cell(finding.text, finding.verdict) for finding in judgement.findings]
    yield Section("Verdict", [Verdict(judgement.verdict, judgement.text, cells)])
    tested = [_test_rows(findings), _software_rows(findings.record.environment)]
    yield Section("What was tested", [Table((), rows, numbers=False) for rows in tested])
    yield agreement_section(findings)
    yield ground_motion_section(findings)
    for column, axis in enumerate(axes):
        title = f" of {axis}" if len(axes) > 1 else ""
        yield from history_sections(findings, column, title)
        yield tracking_section(findings, column, title)
        yield hysteresis_section(findings, column, title)
        yield spectra_section(findings, column, title)
    yield energy_section(findings)
    yield Section("Timing", list(_timing(findings)))
    yield Section("Estimates", list(_estimates(findings.record)))
    yield Section("Interlock and events", list(_events(findings.record)))
    yield Section("Parameters", _parameters(findings.record))


def _test_rows(findings: Findings) -> list[tuple[str, str]]:
    record, summary = findings.record, findings.summary
    sections = record.experiment.sections
    force, rig = sections.get("reference_force", {}), sections.get("rig")
    ground, pace = record.series[GROUND_MOTION.name].values, summary["realtime_factor"]
    largest = f"{np.abs(ground).max():.4g} m/s²" if ground.size else "unknown"
    fast = "" if pace is None else f", {pace:.3g} times real time"
    rows = [
        ("method", f"{force.get('method', 'unknown')}, mass ratio {_of(force, 'mass_ratio')}"),
        ("compensation", str(force.get("compensation.method", "unknown"))),
        ("ground motion", _motion(sections.get("ground_motion", {}))),
        ("largest ground acceleration", largest),
        ("axes", ", ".join(record.experiment.axes)),
        ("rate and steps", f"{summary['rate_hz']:g} Hz, {summary['steps']} steps"),
        ("duration", f"{summary['duration_s']:g} s{fast}"),
    ]
    if rig is None:
        return [*rows, ("rig", "hardware, or one whose parameters are not recorded")]
    kind, specimen = _of(rig, "actuator.kind"), _of(rig, "specimen.kind")
    rows.append(("rig", f"simulated; actuator {kind}, specimen {specimen}"))
    units = {"mass": "kg", "damping": "N s/m", "stiffness": "N/m"}
    return rows + [(name, f"{_of(rig, f'specimen.{name}')} {units[name]}") for name in units]


def _software_rows(environment: dict[str, Any]) -> list[tuple[str, str]]:
    git, versions = environment.get("git") or {}, environment.get("versions") or {}
    dirty = " and changes" if git.get("dirty") else ""
    return [
        ("started", str(environment.get("start", "unknown"))),
        ("mode", str(environment.get("mode", "unknown"))),
        ("revision", f"{git['revision'][:12]}{dirty}" if git.get("revision") else "unknown"),
        *((key, str(environment[key])) for key in _SOFTWARE if key in environment),
        *((name, str(version or "not installed")) for name, version in versions.items()),
    ]


def _motion(section: dict[str, Any]) -> str:
    if not section:
        return "unknown"
    if section.get("file"):
        name = Path(section["file"]).name
    else:
        name = f"synthetic, seed {_of(section, 'synthetic.seed')}"
    if section.get("peak_force"):
        name += f", scaled to {section['peak_force']:g} N"
    if section.get("time_scale", 1.0) != 1.0:
        name += f", time scale {section['time_scale']:g}"
    return name


def _of(section: Any, name: str) -> str:
    return _value(section[name]) if name in section else "unknown"


def _value(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(_value(item) for item in value) or "(none)"
    if isinstance(value, float):
        return f"{value:.6g}"
    return str(value) if value != "" else '""'


def _parameters(record: Record) -> list[Block]:
    """Every parameter of every node, as resolved."""
    if not record.described:
        return [Text("The record does not hold the nodes' parameters.")]
    return [
        Table(
            (node, ""),
            [(name, _value(value)) for name, value in sorted(section.items())],
            numbers=False,
        )
        for node, section in sorted(record.experiment.sections.items())
    ]


def _timing(findings: Findings) -> Iterator[Block]:
    """Round trips as a histogram, missed commands, gaps by topic."""
    timing, summary, record = findings.timing, findings.summary, findings.record
    rows = _loss_rows(summary, record)
    if timing is None:
        why = "The offline loop has no messages that could be late."
        if record.environment.get("mode") != "simulate":
            why = "The record does not say when its messages were received."
        yield Table((), rows)
        yield Text(why)
        return
    trips, numbers = timing.round_trip_s * 1e3, summary["timing"]
    rows += _stall_rows(numbers["stalls"], bool(summary["missed"]))
    found = numbers["round_trip_at_the_rig_s"]
    rows += rows_of((_milliseconds(f"round trip at the rig, {key}", key) for key in found), found)
    found = numbers["round_trip_s"]
    keys = [key for key in found if key.startswith("p") or key == "largest"]
    rows += rows_of((_milliseconds(f"round trip, as recorded, {key}", key) for key in keys), found)
    rows.append(["of these longer than a period", str(found["over_a_period"])])
    yield Table((), rows, numbers=False)
    if len(trips):
        panel = plot("round trip / ms", "steps", log_y=True)
        counts, edges = np.histogram(trips, _BINS)
        bars(panel, edges, counts.astype(float))
        mark(panel, numbers["period_s"] * 1e3)
        caption = (
            "From a step's state to the command that answers it, as the recorder received them, "
            "which may have to wait for its core longer than the loop does; dashed: one period."
        )
        yield Plot(panel, caption)
    if not numbers["paced"]:
        yield Text("The rig was in lockstep: it waited for each command.")
    gaps = [
        [topic, *(column.text(gap) for column in _GAPS)] for topic, gap in numbers["gaps"].items()
    ]
    yield Table(("topic", *(column.label for column in _GAPS)), gaps)


def _loss_rows(summary: dict[str, Any], record: Record) -> list[list[str]]:
    missed, steps, overruns = summary["missed"], summary["steps"], summary["overruns"]
    commands = "unknown" if missed is None else f"{missed} of {steps}"
    if missed and steps:
        commands += f" ({percent(missed / steps)})"
    rows = [["steps without a command in time", commands]]
    if missed:
        listed = record.missed_steps
        more = ", ..." if missed > len(listed) else ""
        rows.append(["these steps", ", ".join(map(str, listed)) + more])
    held_up = "unknown" if overruns is None else str(overruns)
    rows.append(["times the rig's own clock was held up", held_up])
    return rows + (rows_of(_LINK, summary["link"]) if summary["link"] else [])


def _stall_rows(stalls: dict[str, Any] | None, is_missed: bool) -> list[list[str]]:
    """Rows on the machine itself, as a bare process saw it that slept on the loop's core."""
    if stalls is None:
        return []
    share = percent(stalls["count"] / max(stalls["beats"], 1))
    text = (
        f"{stalls['count']} of {stalls['beats']} wake-ups ({share}) more than "
        f"{stalls['late_s'] * 1e3:.3f} ms late, the worst by {stalls['longest_s'] * 1e3:.3f} ms"
    )
    rows = [["the machine itself: a process that only slept", text]]
    if is_missed:
        text = f"{stalls['missed_in_a_stall']} of the {stalls['missed_listed']} listed"
        rows.append(["missed while the machine stood still", text])
    return rows


def _milliseconds(label: str, key: str) -> Number:
    return Number(label, key, "ms", 1e3, ".3f")


def _estimates(record: Record) -> Iterator[Block]:
    """Show what the compensation method identified, over time."""
    estimates, axes = record.estimates, record.experiment.axes
    if estimates is None:
        yield Text("The compensation method identified nothing on line.")
        return
    time = estimates.steps * record.experiment.timebase.dt
    looks = list(zip(axes, OTHERS, strict=False)) if len(axes) > 1 else [("", SECOND)]
    for row, name in enumerate(estimates.names):
        _, scale = DISPLAY_UNITS.get(name, ("", 1.0))
        panel = plot("time / s", axis_label(name), height=200)
        for column, (axis, color) in enumerate(looks):
            y = estimates.values[:, row, column] * scale
            line(panel, time, y, axis or name, color=color)
        yield Plot(panel)


def _events(record: Record) -> Iterator[Block]:
    """States of the test, warnings and trips, as the nodes told them."""
    trip, events = record.trip, record.events
    if trip is not None:
        text = f"tripped at step {trip.step}, {trip.time_s:.3f} s: {trip.reason}"
        yield Table((), [("interlock", Cell(text, Mark.BAD))], numbers=False)
    if events:
        rows = [
            (f"{e.time_s:.3f} s", e.source, Cell(e.text, _MARKS.get(e.level, Mark.NONE)))
            for e in events
        ]
        yield Table(("received", "from", "what"), rows, numbers=False)
    if trip is None and not events:
        yield Text("No trip, and the record holds no states or warnings of nodes.")
