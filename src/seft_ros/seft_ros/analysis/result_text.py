"""Summaries and comparisons of tests for people: tables, verdicts, where records differ."""

from dataclasses import replace
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
    Number,
    make_table,
    number,
    percent,
    small_percent,
)
from seft_ros.ground_motion.column_file import STANDARD_GRAVITY
from seft_ros.reference_force.reference_force_parameters import OF_MODEL

AGREEMENT = (
    Number("peak", "peak"),
    Number("reference\npeak", "reference_peak"),
    Number("NRMSE", "nrmse", form=percent),
    Number("NRMSE\naligned", "nrmse_aligned", form=percent),
    Number("delay", "delay_s", "ms", 1e3, ".2f"),
)
"""Agreement of a quantity with its reference, by column; the peaks are in the quantity's unit."""

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
        title=Text("\n".join([title_of(record), *_notes(summary)])),
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


def motion_lines(facts: dict[str, Any]) -> list[str]:
    """Say where a ground motion is from, how it was scaled, and what it is in the test.

    ``facts`` are those of `seft_ros.ground_motion.ground_motion_block.motion_facts`.
    """
    unit = f" in {facts['unit']}" if facts["unit"] else ""
    peak_force = facts["peak_force_n"]
    why = f" (peak_force {peak_force:g} N)" if peak_force else ""
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
    if not (summary["stable"] and summary["complete"]):
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
        largest = error = "-"
        if row["compared"]:
            error = small_percent(row["nrmse"])
        if row["compared"] and row["max_abs"] is not None:
            differing = (
                field
                for field, errors in row["fields"].items()
                if errors["max_abs"] == row["max_abs"] != 0
            )
            unit = FIELD_UNITS.get((topic, next(differing, "")), "")
            largest = f"{row['max_abs']:.2g} {unit}"
        rows.append([topic, *map(str, counts), largest, error])
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
        errors = []
        for topic in (topics[name] for name in names):
            equal = all(field["max_abs"] == 0 for field in topic["fields"].values())
            error = "same" if equal else small_percent(topic["nrmse"])
            errors.append(error if topic["compared"] else "-")
        missing = sum(row["missing_b"] for row in topics.values())
        rows.append([label, *errors, str(missing)])
        lines.append(_coloured(f"{label}: {_verdict(comparison, first, label)}", comparison))
    title = f"NRMSE against {first}"
    return Group(make_table(("", *names, "missing"), rows, wrap=True, title=title), *lines)


def _coloured(text: str, comparison: dict[str, Any]) -> Text:
    return Text(text, style="bold green" if comparison["identical"] else "bold red")


def _differences(comparison: dict[str, Any], a: str, b: str) -> list[str]:
    """Say how two records differ, the verdict first."""
    names = {"a": a, "b": b}
    first, value = (comparison[key] for key in ("first_difference", "first_value_difference"))
    counts = comparison["missed"]
    missed = ", ".join(f"{counts[key]} in {names[key]}" for key in names if counts[key])
    text = _verdict(comparison, a, b)
    lines = [f"{text}; steps that missed the command deadline: {missed}" if missed else text]
    if first is not None and first["field"] is None:
        lines.append(
            "all samples that both have are equal, bit for bit"
            if value is None
            else f"first value that differs, {_where(value, names)}"
        )
    rates, lengths = comparison["rate_hz"], comparison["length_s"]
    if comparison["aligned_by"] == "time":
        lines.append(
            f"rates differ ({rates['a']:g} Hz in {a}, {rates['b']:g} Hz in {b}): compared are the "
            "samples at times that both have"
        )
    if lengths["a"] != lengths["b"]:
        lines.append(f"lengths differ: {lengths['a']:g} s in {a}, {lengths['b']:g} s in {b}")
    axes = comparison["axes"]
    alone = [
        f"{', '.join(axes[f'only_{key}'])} only in {name}"
        for key, name in names.items()
        if axes[f"only_{key}"]
    ]
    if alone:
        lines.append(f"axes differ: {'; '.join(alone)}; compared: {', '.join(axes['compared'])}")
    return lines


def _verdict(comparison: dict[str, Any], a: str, b: str) -> str:
    """Say whether two records are identical, and if not, where they first differ."""
    first = comparison["first_difference"]
    if comparison["identical"]:
        return "identical, bit for bit"
    if first is None:
        return "not the same test, but equal, bit for bit, where both have samples"
    return f"first difference {_where(first, {'a': a, 'b': b})}"


def _where(first: dict[str, Any], names: dict[str, str]) -> str:
    where = f"at step {first['step']}"
    if "step_b" in first:
        where += f" of {names['a']} ({first['step_b']} of {names['b']})"
    where += f", {first['topic']}"
    if first["field"] is None:
        lacking = "a" if first["a"] == "missing" else "b"
        return f"{where}: the sample is missing in {names[lacking]}"
    values = f"{first['a']!r} in {names['a']}, {first['b']!r} in {names['b']}"
    return f"{where}, {first['field']} of axis {first['axis']}: {values}"
