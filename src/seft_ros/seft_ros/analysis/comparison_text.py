"""A comparison of records for people: tables, verdicts, and where records first differ."""

from typing import Any

from rich.console import Group
from rich.text import Text
from seft_msgs_py.wire.topics import LOOP_TOPICS, TARGET

from seft_ros.drawing.tables import make_table, small_percent

FIELD_UNITS = {
    (topic.name, quantity): unit
    for topic in (*LOOP_TOPICS, TARGET)
    for quantity, unit in zip(topic.quantities, topic.units, strict=True)
}
"""Topic and field -> its unit."""


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
    first, *more = _lines(comparison, a, b)
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


def _lines(comparison: dict[str, Any], a: str, b: str) -> list[str]:
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
