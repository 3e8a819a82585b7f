"""The report of a test as a page; its sections on the experiment and how it ran."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from seft_ros.analysis import report_sections
from seft_ros.analysis.assessment import ramp_note
from seft_ros.analysis.equivalent_motion import tracked_of
from seft_ros.analysis.report_numbers import Report
from seft_ros.analysis.result_text import OF_THE_MODEL, agreement_table, test_rows, title_of
from seft_ros.analysis.timing import timing_of
from seft_ros.bags.recording import Recording
from seft_ros.drawing import page, style
from seft_ros.drawing.page import PageSection, Text
from seft_ros.drawing.style import Cell, Mark, Number, TextTable, percent, rows_of
from seft_ros.reference_force.reference_force_parameters import OF_MODEL

_BINS = 80
_MACHINE = ("python", "platform", "cpus")
_MARKS = {"ok": Mark.NONE, "warn": Mark.DOUBT, "error": Mark.BAD, "stale": Mark.BAD}
_OFFLINE = "The offline loop has no messages that could be late."
_WITHOUT_TIMES = "The recording does not say when its messages were received."
_OF_TRIPS = (
    "From a step's state to the command that answers it, as the recorder received them, which may "
    "have to wait for its core longer than the loop does; dashed: one period."
)
_ROUND_TRIPS = {
    "round trip at the rig": "round_trip_at_the_rig_s",
    "round trip, recorded": "round_trip_s",
}
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
_REHEARSAL = (
    Number("rehearsal before the test, steps", "steps", form=str),
    Number("of these missed", "missed", form=str),
    Number("its round trip, p99", "round_trip_s.p99", "ms", 1e3, ".3f"),
)


def write_report(report: Report, name: str, path: Path) -> None:
    """Write the page of a test of this name; an InputError says that it can't be written."""
    page.write_page(path, f"Test {name}", title_of(report.recording), list(_sections(report)))


def _sections(report: Report) -> Iterator[PageSection]:
    assessment, recording = report.assessment, report.recording
    axes, signals = recording.experiment.axes, tracked_of(recording)
    verdicts = [
        page.VerdictBox(one.verdict, one.text, [Cell(f.whole, f.verdict) for f in one.findings])
        for one in (assessment, report.laboratory)
        if one is not None
    ]
    yield PageSection("Verdict", verdicts)
    tested = [_test_rows(report), _software_rows(recording.environment)]
    yield PageSection("What was tested", [TextTable((), rows, numbers=False) for rows in tested])
    yield _agreement(report)
    yield PageSection("The equivalent ground motion", list(report_sections.ground_motion(report)))
    for column, axis in enumerate(axes):
        title = f" of {axis}" if len(axes) > 1 else ""
        yield from report_sections.history_sections(report, column, title)
        tracking = report_sections.tracking(report, signals, column)
        yield PageSection(f"Force tracking{title}", list(tracking))
        yield PageSection(f"Hysteresis{title}", list(report_sections.hysteresis(report, column)))
        yield PageSection(f"Spectra{title}", list(report_sections.spectra(report, column)))
    yield PageSection("Energy", list(report_sections.energy(report)))
    yield PageSection("Timing", list(_timing(report)))
    if blocks := list(report_sections.computed_model(recording)):
        yield PageSection("Computed model", blocks)
    yield PageSection("Estimates", list(_estimates(recording)))
    yield PageSection("Interlock and events", list(_events(recording)))
    yield PageSection("Parameters", _parameters(recording))


def _agreement(report: Report) -> PageSection:
    """Table of peaks, errors and delays."""
    summary = report.summary
    note = [Text(OF_THE_MODEL)] if summary["reference_specimen"] == "model" else []
    if left_out := ramp_note(summary):
        note.append(Text(f"{left_out[0].upper()}{left_out[1:]}."))
    return PageSection("Agreement with the reference response", [*note, agreement_table(summary)])


def _test_rows(report: Report) -> list[tuple[str, str]]:
    recording, summary = report.recording, report.summary
    sections = recording.experiment.sections
    force, rig = sections.get("reference_force", {}), sections.get("rig")
    rows = [
        ("method", f"{_of(force, 'method')}, mass ratio {_of(force, 'mass_ratio')}"),
        ("compensation", _of(force, "compensation.method")),
        ("axes", ", ".join(recording.experiment.axes)),
        *test_rows(summary),
    ]
    if rig is None:
        return [*rows, ("rig", "hardware, or one whose parameters are not recorded")]
    kind, specimen = _of(rig, "actuator.kind"), _of(rig, "simulated.specimen.kind")
    rows.append(("rig", f"simulated; actuator {kind}, specimen {specimen}"))
    units = {"mass": "kg", "damping": "N s/m", "stiffness": "N/m"}
    return rows + [
        (name, f"{_of(rig, f'simulated.specimen.{name}')} {units[name]}") for name in units
    ]


def _software_rows(environment: dict[str, Any]) -> list[tuple[str, str]]:
    git, versions = environment.get("git") or {}, environment.get("versions") or {}
    dirty = " and changes" if git.get("dirty") else ""
    return [
        ("started", str(environment.get("start", "unknown"))),
        ("mode", str(environment.get("mode", "unknown"))),
        ("revision", f"{git['revision'][:12]}{dirty}" if git.get("revision") else "unknown"),
        *((key, str(environment[key])) for key in _MACHINE if key in environment),
        *((name, str(version or "not installed")) for name, version in versions.items()),
    ]


def _of(section: Any, name: str) -> str:
    return _value(section[name]) if name in section else "unknown"


def _value(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(_value(item) for item in value) or "(none)"
    if isinstance(value, float):
        return f"{value:.6g}"
    return str(value) if value != "" else '""'


def _parameters(recording: Recording) -> list[page.Block]:
    """Every parameter, as resolved: those that nodes share, ``/**``, then the others of each."""
    sections = recording.experiment.sections
    holders = Counter(name for section in sections.values() for name in section)
    every = {name: value for section in sections.values() for name, value in section.items()}
    shared = {
        name: value
        for name, value in every.items()
        if holders[name] > 1 and all(one.get(name, value) == value for one in sections.values())
    }
    tables = {"/**": shared}
    for node, section in sorted(sections.items()):
        tables[node] = {name: section[name] for name in section if name not in shared}
    return [
        TextTable((node, ""), [(n, _value(v)) for n, v in sorted(one.items())], numbers=False)
        for node, one in tables.items()
    ]


def _timing(report: Report) -> Iterator[page.Block]:
    """Missed deadlines, and round trips as a histogram."""
    summary, recording = report.summary, report.recording
    timing, rows = timing_of(recording), _loss_rows(summary, recording)
    if timing is None:
        yield TextTable((), rows)
        offline = recording.environment.get("mode") == "simulate"
        yield Text(_OFFLINE if offline else _WITHOUT_TIMES)
        return
    numbers, trips = timing.numbers, timing.round_trip_s * 1e3
    for label, key in _ROUND_TRIPS.items():
        times = [name for name in numbers[key] if name not in ("over_a_period", "steps")]
        columns = (Number(f"{label}, {name}", name, "ms", 1e3, ".3f") for name in times)
        rows += rows_of(columns, numbers[key])
    rows.append(["of these longer than a period", str(numbers["round_trip_s"]["over_a_period"])])
    if numbers["rehearsal"] is not None:
        rows += rows_of(_REHEARSAL, numbers["rehearsal"])
    yield TextTable((), rows, numbers=False)
    if len(trips):
        panel = page.plot("round trip / ms", "steps", log_y=True)
        counts, edges = np.histogram(trips, _BINS)
        page.bars(panel, edges, counts.astype(float))
        page.mark(panel, numbers["period_s"] * 1e3)
        yield page.Plot(panel, _OF_TRIPS)
    if not numbers["paced"]:
        yield Text("The rig was in lockstep: it waited for each command.")


def _loss_rows(summary: dict[str, Any], recording: Recording) -> list[list[str]]:
    missed, steps, overruns = summary["missed"], summary["steps"], summary["overruns"]
    share = f" ({percent(missed / steps)})" if missed and steps else ""
    count = "unknown" if missed is None else f"{missed} of {steps}{share}"
    rows = [["steps that missed the command deadline", count]]
    if missed:
        more = ["..."] if missed > len(recording.missed_steps) else []
        rows.append(["these steps", ", ".join([*map(str, recording.missed_steps), *more])])
    rows.append(["sampling overruns of the rig", "unknown" if overruns is None else str(overruns)])
    if summary["link"]:
        rows += rows_of(_LINK, summary["link"])
    stalls = summary["timing"] and summary["timing"]["stalls"]
    if stalls:
        share = percent(stalls["count"] / max(stalls["beats"], 1))
        late, worst = (f"{stalls[key] * 1e3:.3f} ms" for key in ("late_s", "longest_s"))
        count = f"{stalls['count']} of {stalls['beats']} wake-ups ({share})"
        text = f"{count} more than {late} late, the worst by {worst}"
        rows.append(["host scheduling stalls, as a process that only slept saw them", text])
        if missed:
            text = f"{stalls['missed_in_a_stall']} of the {stalls['missed_listed']} listed"
            rows.append(["missed during a stall of the host", text])
    return rows


def _estimates(recording: Recording) -> Iterator[page.Block]:
    """Show what the compensation method identified, over time."""
    estimates, axes = recording.estimates, recording.experiment.axes
    if estimates is None:
        yield Text("The compensation method identified nothing on line.")
        return
    time = estimates.steps * recording.experiment.timebase.dt
    looks = list(zip(axes, style.OTHERS, strict=False)) if len(axes) > 1 else [("", style.SECOND)]
    for row, name in enumerate(estimates.names):
        if not name.startswith(OF_MODEL):
            _, scale = style.DISPLAY_UNITS.get(name, ("", 1.0))
            panel = page.plot("time / s", style.axis_label(name), height=200)
            for column, (axis, color) in enumerate(looks):
                y = estimates.values[:, row, column] * scale
                page.line(panel, time, y, axis or name, color=color)
            yield page.Plot(panel)


def _events(recording: Recording) -> Iterator[page.Block]:
    """States of the test, warnings and trips, as reported by the nodes."""
    trip, events = recording.trip, recording.events
    if trip is not None:
        text = f"tripped at step {trip.step}, {trip.time_s:.3f} s: {trip.reason}"
        yield TextTable((), [("interlock", Cell(text, Mark.BAD))], numbers=False, wide=True)
    if events:
        rows = [
            (f"{e.time_s:.3f} s", e.source, Cell(e.text, _MARKS.get(e.level, Mark.NONE)))
            for e in events
        ]
        yield TextTable(("received", "from", "what"), rows, numbers=False, wide=True)
    if trip is None and not events:
        yield Text("No trip, and the recording holds no states or warnings of nodes.")
