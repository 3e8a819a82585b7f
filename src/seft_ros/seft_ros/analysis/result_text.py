"""Summaries and comparisons of tests for people: tables, verdicts, where records differ."""

from typing import Any

from rich.console import Group
from rich.table import Table
from rich.text import Text
from seft_msgs_py.wire.topics import LOOP_TOPICS, TARGET

from seft_ros.analysis.judgement import ramp_note, verdict, worst_response
from seft_ros.bags.record import Record
from seft_ros.drawing.style import (
    DISPLAY_UNITS,
    GOOD_ERROR,
    RESPONSES,
    make_table,
    number,
    percent,
    small_percent,
)
from seft_ros.ground_motion.column_file import STANDARD_GRAVITY
from seft_ros.reference_force.reference_force_parameters import OF_MODEL

AGREEMENT = ("peak", "reference\npeak", "NRMSE", "NRMSE\naligned", "delay")
"""Headings of `agreement_rows`."""

FIELD_UNITS = {
    (topic.name, quantity): unit
    for topic in (*LOOP_TOPICS, TARGET)
    for quantity, unit in zip(topic.quantities, topic.units, strict=True)
}
"""Topic and field -> its unit."""


def agreement_rows(part: dict[str, Any], prefix: str = "") -> list[list[str]]:
    """Make a row of each measured quantity in a summary, or in the part of it on an axis."""
    rows = []
    for quantity in RESPONSES:
        measures, (unit, scale) = part[quantity], DISPLAY_UNITS[quantity]
        row = [
            f"{prefix}{quantity}",
            *(number(measures[key], scale, unit) for key in ("peak", "reference_peak")),
            *(percent(measures[key]) for key in ("nrmse", "nrmse_aligned")),
            number(measures["delay_s"], 1e3, "ms", ".2f"),
        ]
        rows.append(row)
    return rows


def summary_table(record: Record, summary: dict[str, Any]) -> Table:
    """Tabulate a test's agreement with the reference response; the caption is its verdict."""
    rows: list[Any] = agreement_rows(summary)
    if len(summary["axes"]) > 1:
        for axis, part in summary["axes"].items():
            rows += [None, *agreement_rows(part, f"{axis} ")]
    title = Text("\n".join([title_of(record), *_notes(summary)]))
    caption = Text(verdict(summary), style=f"bold {_colour(summary)}")
    return make_table(["", *AGREEMENT], rows, title=title, caption=caption)


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


def motion_lines(facts: dict[str, Any]) -> list[str]:
    """Say where a ground motion is from, how it was scaled, and what it is in the test.

    ``facts`` are those of `seft_ros.ground_motion.ground_motion_block.motion_facts`.
    """
    unit = f" in {facts['unit']}" if facts["unit"] else ""
    why = f" (peak_force {facts['peak_force_n']:g} N)" if facts["peak_force_n"] else ""
    largest = [f"{peak:.4g}" for peak in facts["peak_acceleration"]]
    shown = largest if len(set(largest)) > 1 else largest[:1]
    in_g = max(facts["peak_acceleration"]) / STANDARD_GRAVITY
    return [
        f"ground motion: {facts['source']}{unit}, dt {facts['dt_s']:g} s",
        f"its scale: factor {facts['scale_factor']:.4g}{why}, time scale {facts['time_scale']:g}",
        f"in the test: PGA {', '.join(shown)} m/s² ({in_g:.3g} g), "
        f"{facts['duration_s']:g} s and {facts['tail_s']:g} s of tail",
    ]


def _colour(summary: dict[str, Any]) -> str:
    """Red: the test did not run to its end; yellow: it did, and is wrong or missed deadlines."""
    if summary["damage"] or not (summary["stable"] and summary["complete"]):
        return "red"
    simulated = summary["reference_specimen"] == "simulated"
    error = summary["displacement"]["nrmse"] if simulated else worst_response(summary)
    right = error is not None and error <= GOOD_ERROR
    return "green" if right and not summary["missed"] else "yellow"


def _notes(summary: dict[str, Any]) -> list[str]:
    """Say how fast it ran, what shows without a model that it is right, what was identified."""
    pace = f"{summary['steps']} steps, {summary['duration_s']:g} s"
    if summary["realtime_factor"] is not None:
        pace += f", in {summary['wall_s']:.3g} s ({summary['realtime_factor']:.3g} x real time)"
    motion = summary["ground_motion"]
    lines = [*(motion_lines(motion) if motion else []), pace]
    if left_out := ramp_note(summary):
        lines.append(left_out)
    found, tracking = summary["equivalent_motion"], summary["tracking_error"]
    if found is not None:
        lines.append(
            "equivalent ground motion against the one asked for: response differs by "
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
            if name.startswith(OF_MODEL):
                text = f"{least} to {largest}"
            texts.append(f"{axis} {text}" if len(by_axis) > 1 else text)
        how = "" if name.startswith(OF_MODEL) else " as identified"
        lines.append(f"{name}{how}: {', '.join(texts)}")
    return lines


def legend(label: str, bag: dict[str, Any]) -> str:
    """One line on a bag, from what `describe_bag` gives."""
    known = bag["title"] or f"configuration not recorded, {bag['rate_hz']:g} Hz"
    parts = [known, bag["mode"], f"{bag['length_s']:g} s"]
    if bag["complete"] is False:
        parts.append("cut off")
    if bag["damage"]:
        parts.append("damaged")
    if bag["undecodable"]:
        parts.append(f"{bag['undecodable']} messages not understood")
    return f"{label}: {bag['bag']} ({', '.join(part for part in parts if part)})"


def comparison_table(comparison: dict[str, Any], a: str = "a", b: str = "b") -> Group:
    """Tabulate how two records differ; the lines below say where they first do.

    Parameters
    ----------
    comparison : dict
        As `seft_ros.analysis.comparison.compare` gives it.
    a, b : str
        Names of the records.
    """
    headings = (f"in {a}", f"in {b}", f"not\nin {a}", f"not\nin {b}", "largest", "NRMSE")
    rows = []
    for topic, row in comparison["topics"].items():
        counts = [row[key] for key in ("samples_a", "samples_b", "missing_a", "missing_b")]
        largest = row["max_abs"] if row["compared"] else None
        fields = [name for name, e in row["fields"].items() if e["max_abs"] == largest != 0]
        unit = FIELD_UNITS.get((topic, fields[0]), "") if fields else ""
        rows.append([topic, *map(str, counts), number(largest, 1.0, unit, ".2g"), _error(row)])
    first, *more = _differences(comparison, a, b)
    table = make_table(("topic", *headings), rows, title=f"{b} against {a}")
    return Group(table, _coloured(first, comparison), *map(Text, more))


def comparisons_table(comparisons: list[dict[str, Any]], labels: list[str]) -> Group:
    """Tabulate how further records differ from the first: NRMSE by topic; verdicts below.

    ``labels`` name the records, the first included.
    """
    first, *others = labels
    names = [topic.name for topic in LOOP_TOPICS]
    rows, lines = [], []
    for label, comparison in zip(others, comparisons, strict=True):
        topics = comparison["topics"]
        errors = [_error(topics[name], "same") for name in names]
        missing = sum(row["missing_b"] for row in topics.values())
        rows.append([label, *errors, str(missing)])
        lines.append(_coloured(f"{label}: {_verdict(comparison, first, label)}", comparison))
    title = f"NRMSE against {first}"
    return Group(make_table(("", *names, "missing"), rows, wrap=True, title=title), *lines)


def _error(row: dict[str, Any], none: str = "") -> str:
    """Write the error of a topic's samples, if any; ``none`` where all are equal."""
    if not row["compared"]:
        return "-"
    return none if none and row["max_abs"] == 0 else small_percent(row["nrmse"])


def _coloured(text: str, comparison: dict[str, Any]) -> Text:
    return Text(text, style="bold green" if comparison["identical"] else "bold red")


def _differences(comparison: dict[str, Any], a: str, b: str) -> list[str]:
    """Say how two records differ, the verdict first."""
    first, value = comparison["first_difference"], comparison["first_value_difference"]
    sides = {"a": a, "b": b}
    counts, rates, lengths, axes = (
        comparison[key] for key in ("missed", "rate_hz", "length_s", "axes")
    )
    missed = ", ".join(f"{counts[key]} in {name}" for key, name in sides.items() if counts[key])
    lines = [_verdict(comparison, a, b)]
    if missed:
        lines[0] += f"; steps that missed the command deadline: {missed}"
    if first is not None and first["field"] is None:
        where = value and f"first value that differs, {_where(value, a, b)}"
        lines.append(where or "all samples that both have are equal, bit for bit")
    if comparison["aligned_by"] == "time":
        lines.append(
            f"rates differ ({rates['a']:g} Hz in {a}, {rates['b']:g} Hz in {b}): compared are the "
            "samples at times that both have"
        )
    if lengths["a"] != lengths["b"]:
        lines.append(f"lengths differ: {lengths['a']:g} s in {a}, {lengths['b']:g} s in {b}")
    only = {name: ", ".join(axes[f"only_{key}"]) for key, name in sides.items()}
    if alone := [f"{some} only in {name}" for name, some in only.items() if some]:
        lines.append(f"axes differ: {'; '.join(alone)}; compared: {', '.join(axes['compared'])}")
    return lines


def _verdict(comparison: dict[str, Any], a: str, b: str) -> str:
    """Say whether two records are identical, and if not, where they first differ."""
    first = comparison["first_difference"]
    if comparison["identical"]:
        return "identical, bit for bit"
    if first is None:
        return "not the same test, but equal, bit for bit, where both have samples"
    return f"first difference {_where(first, a, b)}"


def _where(first: dict[str, Any], a: str, b: str) -> str:
    also = f" of {a} ({first['step_b']} of {b})" if "step_b" in first else ""
    where = f"at step {first['step']}{also}, {first['topic']}"
    if first["field"] is None:
        return f"{where}: the sample is missing in {a if first['a'] == 'missing' else b}"
    values = f"{first['a']!r} in {a}, {first['b']!r} in {b}"
    return f"{where}, {first['field']} of axis {first['axis']}: {values}"
