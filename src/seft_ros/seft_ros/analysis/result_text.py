"""Summaries and comparisons of tests for people: tables, verdicts, where recordings differ."""

from collections.abc import Iterator, Sequence
from typing import Any

from seft_msgs_py.config.facts import CHANNELS
from seft_msgs_py.wire.topics import LOOP_TOPICS, TARGET
from seft_plant_sim.rig_parameters import LIMIT_UNITS

from seft_ros.analysis.report_numbers import Report
from seft_ros.bags.recording import Recording
from seft_ros.drawing import style
from seft_ros.drawing.style import Texts, TextTable, number, percent
from seft_ros.ground_motion.readers.statements import STANDARD_GRAVITY
from seft_ros.reference_force.reference_force_parameters import OF_MODEL

FIELD_UNITS = {
    (topic.name, quantity): unit
    for topic in (*LOOP_TOPICS, TARGET)
    for quantity, unit in zip(topic.quantities, topic.units, strict=True)
}
"""Topic and field -> its unit."""


OF_THE_MODEL = (
    "The reference response is that of the assumed specimen (/**: specimen): these "
    "errors include how the real one differs from it, and assess no test."
)


def agreement_table(summary: dict[str, Any]) -> TextTable:
    """Tabulate how a test agrees with the reference response: over all axes, then on each."""
    rows: list[list[str] | None] = [*_agreement_rows(summary)]
    if len(summary["axes"]) > 1:
        for axis, part in summary["axes"].items():
            rows += [None, *_agreement_rows(part, f"{axis} ")]
    against = "model's" if summary["reference_specimen"] == "model" else "reference"
    heads = ("", "peak", f"{against}\npeak", "NRMSE", "NRMSE\naligned", "delay")
    return TextTable(heads, rows)


def _agreement_rows(part: dict[str, Any], prefix: str = "") -> Iterator[list[str]]:
    for quantity in style.RESPONSES:
        measures, (unit, scale) = part[quantity], style.DISPLAY_UNITS[quantity]
        yield [
            f"{prefix}{quantity}",
            *(number(measures[key], scale, unit) for key in ("peak", "reference_peak")),
            *(percent(measures[key]) for key in ("nrmse", "nrmse_aligned")),
            number(measures["delay_s"], 1e3, "ms", "z.2f"),
        ]


def summary_texts(report: Report) -> Texts:
    """Show a test on the terminal: what it was, how it agrees with the reference, its verdict."""
    summary, found = report.summary, report.assessment
    facts = TextTable((), [*test_rows(summary), *_cause_rows(summary, found.verdict)])
    table: Texts = [agreement_table(summary)]
    if summary["reference_specimen"] == "model":
        table.append(OF_THE_MODEL)
    findings = (style.Cell(f"  {finding.whole}", finding.verdict) for finding in found.findings)
    seen = report.laboratory
    laboratory = [] if seen is None else [style.Cell(seen.text, seen.verdict)]
    verdict = style.Cell(found.text, found.verdict)
    return [title_of(report.recording), facts, *table, verdict, *findings, *laboratory]


def title_of(recording: Recording) -> str:
    """Name method, mass ratio, compensation and rate of a test in one line."""
    section = recording.experiment.sections.get("reference_force", {})
    parts = [str(section.get("method", "test")).upper()]
    if "mass_ratio" in section:
        parts.append(f"mass ratio {section['mass_ratio']:g}")
    if "compensation.method" in section:
        parts.append(f"compensation {section['compensation.method']}")
    parts.append(f"{recording.experiment.timebase.rate:g} Hz")
    return ", ".join(parts)


def motion_rows(facts: dict[str, Any]) -> list[tuple[str, str]]:
    """Say where a ground motion is from, how it was scaled, and what it is in the test.

    ``facts`` are those of `seft_ros.ground_motion.ground_motion_block.motion_facts`.
    """
    unit = f" in {facts['unit']}" if facts["unit"] else ""
    why = f" (peak_force {facts['peak_force_n']:g} N)" if facts["peak_force_n"] else ""
    largest = [f"{peak:.4g}" for peak in facts["peak_acceleration"]]
    shown = largest if len(set(largest)) > 1 else largest[:1]
    in_g = max(facts["peak_acceleration"]) / STANDARD_GRAVITY
    scale = f"factor {facts['scale_factor']:.4g}{why}, time scale {facts['time_scale']:g}"
    peak = f"PGA {', '.join(shown)} m/s² ({in_g:.3g} g)"
    return [
        ("ground motion", f"{facts['source']}{unit}, dt {facts['dt_s']:g} s"),
        *_read_rows(facts.get("channels", ())),
        *_correction_rows(facts.get("correction")),
        ("its scale", scale),
        ("in the test", f"{peak}, {facts['duration_s']:g} s and {facts['tail_s']:g} s of tail"),
        *(("resampling", done) for done in [facts.get("resampling")] if done),
    ]


def _correction_rows(correction: dict[str, Any] | None) -> list[tuple[str, str]]:
    """Say how a record was corrected, and the largest drift of its axes before and after."""
    if correction is None:
        return []
    shown = (
        ("offset", "offset", "m/s²"),
        ("PGA", "peak_acceleration", "m/s²"),
        ("PGV", "peak_velocity", "m/s"),
        ("PGD", "peak_displacement", "m"),
        ("velocity at the end", "residual_velocity", "m/s"),
        ("displacement at the end", "residual_displacement", "m"),
    )
    changes = []
    for label, name, unit in shown:
        largest = [max(map(abs, correction[when][name])) for when in ("before", "after")]
        changes.append(f"{label} {largest[0]:.3g} to {largest[1]:.3g} {unit}")
    return [("its correction", f"{correction['method']}; {', '.join(changes)}")]


def _read_rows(channels: Sequence[dict[str, Any]]) -> list[tuple[str, str]]:
    """Say which column of a record was taken, and where unit and sampling period come from."""
    texts = [
        f"{c['layout']}, {c['column']}, {c['samples']} samples; unit {c['unit']} ({c['unit_from']})"
        f", dt {c['dt_s']:g} s ({c['dt_from']})"
        for c in channels
    ]
    files = [c["file"] for c in channels]
    if len(set(zip(files, texts, strict=True))) < 2:
        return [("read", text) for text in texts[:1]]
    return [
        (f"read for {c['axis']}", f"{c['file']}, {text}")
        for c, text in zip(channels, texts, strict=True)
    ]


def test_rows(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """Name the ground motion of a test, its length, and how fast it ran."""
    motion = summary["ground_motion"]
    duration = f"{summary['duration_s']:g} s"
    if summary["realtime_factor"] is not None:
        pace = f"{summary['realtime_factor']:.3g} times real time"
        duration += f", in {summary['wall_s']:.3g} s ({pace})"
    return [
        *(motion_rows(motion) if motion else [("ground motion", "unknown")]),
        *_bias_rows(summary["zeroed"]),
        ("rate and steps", f"{summary['rate_hz']:g} Hz, {summary['steps']} steps"),
        ("duration", duration),
    ]


def _bias_rows(zeroed: dict[str, Any] | None) -> list[tuple[str, str]]:
    """Say what the rig subtracts of its channels since it measured them at rest, if anything."""
    if zeroed is None:
        return []
    shown = [
        f"{name} {', '.join(f'{value:.3g}' for value in zeroed['subtracted'][name])} {unit}"
        for name, unit in zip(CHANNELS, LIMIT_UNITS, strict=False)
        if any(zeroed["subtracted"][name])
    ]
    text = "; ".join([*([", ".join(shown)] if shown else []), *filter(None, [zeroed["warning"]])])
    return [("zeroed at rest", text)] if text else []


def _cause_rows(summary: dict[str, Any], mark: style.Mark) -> Iterator[tuple[str, str]]:
    """Say what may explain why a test is not right, and what a model's parameters became."""
    if summary["detectors"] and mark is not style.Mark.GOOD:
        name, share = max(summary["detectors"].items(), key=lambda item: item[1])
        yield "detectors of faults", f"{name} reached {percent(share)} of its threshold"
    for name, by_axis in summary["estimates"].items():
        if name.startswith(OF_MODEL):
            yield name, _by_axis(name, by_axis, "{least} to {largest}")
        elif mark is not style.Mark.GOOD:
            form = "{first} to {last}{unit} (between {least} and {largest})"
            yield f"{name} as identified", _by_axis(name, by_axis, form)


def _by_axis(name: str, by_axis: dict[str, Any], form: str) -> str:
    """Write how an estimate went on each axis, in the unit in which it is displayed."""
    unit, scale = style.DISPLAY_UNITS.get(name, ("", 1.0))
    texts = []
    for axis, part in by_axis.items():
        numbers = {key: number(value, scale) for key, value in part.items()}
        text = form.format(**numbers, unit=unit and f" {unit}")
        texts.append(f"{axis} {text}" if len(by_axis) > 1 else text)
    return ", ".join(texts)


def legend(label: str, bag: dict[str, Any]) -> str:
    """One line on a bag, from what `describe_bag` gives."""
    parts = [bag["title"], bag["mode"], f"{bag['length_s']:g} s"]
    if not bag["complete"]:
        parts.append("cut off")
    if bag["damage"]:
        parts.append("damaged")
    if bag["undecodable"]:
        parts.append(f"{bag['undecodable']} messages not understood")
    return f"{label}: {bag['bag']} ({', '.join(part for part in parts if part)})"


def comparison_texts(comparison: dict[str, Any]) -> Texts:
    """Show how two recordings differ: by quantity, in samples, and where they first do.

    ``comparison`` is what `seft_ros.analysis.comparison.compare_recordings` gives.
    """
    rows = []
    for topic, row in comparison["topics"].items():
        for field, error in row["fields"].items():
            known = error if row["compared"] else {"max_abs": None, "nrmse": None}
            largest = number(known["max_abs"], 1.0, FIELD_UNITS.get((topic, field), ""), ".2g")
            rows.append([f"{topic} {field}", largest, style.small_percent(known["nrmse"])])
    first, *more = _differences(comparison)
    return [
        TextTable(("difference", "largest", "NRMSE"), rows),
        style.Cell(first, style.Mark.GOOD if comparison["identical"] else style.Mark.BAD),
        *_sample_counts(comparison),
        *more,
    ]


def _sample_counts(comparison: dict[str, Any]) -> Iterator[str]:
    """Say of each topic on which samples are missing how many either recording has."""
    for topic, row in comparison["topics"].items():
        if row["missing_a"] or row["missing_b"]:
            counts = f"{row['samples_a']} samples in a and {row['samples_b']} in b"
            yield f"{topic}: {counts}, {row['missing_a']} not in a, {row['missing_b']} not in b"


def _differences(comparison: dict[str, Any]) -> list[str]:
    """Say how two recordings differ, the verdict first."""
    first, value = comparison["first_difference"], comparison["first_value_difference"]
    counts, lengths = comparison["missed"], comparison["length_s"]
    missed = ", ".join(f"{counts[name]} in {name}" for name in "ab" if counts[name])
    lines = ["identical, bit for bit" if first is None else f"first difference {_where(first)}"]
    if missed:
        lines[0] += f"; steps that missed the command deadline: {missed}"
    if first is not None and first["field"] is None:
        where = value and f"first value that differs, {_where(value)}"
        lines.append(where or "all samples that both have are equal, bit for bit")
    if lengths["a"] != lengths["b"]:
        lines.append(f"lengths differ: {lengths['a']:g} s in a, {lengths['b']:g} s in b")
    return lines


def _where(first: dict[str, Any]) -> str:
    where = f"at step {first['step']}, {first['topic']}"
    if first["field"] is None:
        return f"{where}: the sample is missing in {'a' if first['a'] == 'missing' else 'b'}"
    values = f"{first['a']!r} in a, {first['b']!r} in b"
    return f"{where}, {first['field']} of axis {first['axis']}: {values}"
