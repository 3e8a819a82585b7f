"""A comparison for people: tables, the verdict, where records first differ, what is not common."""

from typing import Any

from rich.console import Group
from rich.text import Text
from seft_msgs_py.wire.topics import LOOP_TOPICS, TARGET

from seft_ros.analysis.comparison import length_s
from seft_ros.analysis.summary_text import title_of
from seft_ros.bags.bag_reader import UNDECODABLE
from seft_ros.bags.record import Record
from seft_ros.drawing.tables import make_table, small_percent

FIELD_UNITS = {
    (topic.name, quantity): unit
    for topic in (*LOOP_TOPICS, TARGET)
    for quantity, unit in zip(topic.quantities, topic.units, strict=True)
}
"""Topic and field -> its unit."""


def describe_bag(path: str, record: Record) -> dict[str, Any]:
    """Say what a bag is, as ``--json`` prints it; what it does not tell is None."""
    return {
        "bag": path,
        "title": title_of(record) if record.described else None,
        "mode": record.environment.get("mode"),
        "rate_hz": record.experiment.timebase.rate,
        "axes": list(record.experiment.axes),
        "length_s": length_s(record),
        "complete": record.complete if record.described else None,
        "undecodable": record.environment.get(UNDECODABLE, 0),
    }


def legend(label: str, bag: dict[str, Any]) -> str:
    """One line on a bag, of what `describe_bag` gives."""
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
        What the records are called.
    """
    headings = (f"in {a}", f"in {b}", f"not\nin {a}", f"not\nin {b}", "largest", "NRMSE")
    rows = []
    for topic, row in comparison["topics"].items():
        counts = [row[key] for key in ("samples_a", "samples_b", "missing_a", "missing_b")]
        largest = "-" if row["max_abs"] is None else f"{row['max_abs']:.2g} {_unit(topic, row)}"
        errors = (largest, small_percent(row["nrmse"])) if row["compared"] else ("-", "-")
        rows.append([topic, *map(str, counts), *errors])
    first, *more = difference_lines(comparison, a, b)
    table = make_table(("topic", *headings), rows, title=f"{b} against {a}")
    return Group(table, _coloured(first, comparison), *map(Text, more))


def comparisons_table(comparisons: list[dict[str, Any]], labels: list[str]) -> Group:
    """Tabulate how further records differ from the first: NRMSE by topic; verdicts below.

    ``labels`` are what the records are called, the first included.
    """
    first, *others = labels
    names = [topic.name for topic in LOOP_TOPICS]
    rows, lines = [], []
    for label, comparison in zip(others, comparisons, strict=True):
        topics = comparison["topics"]
        missing = sum(row["missing_b"] for row in topics.values())
        rows.append([label, *(_agreement(topics[name]) for name in names), str(missing)])
        lines.append(_coloured(f"{label}: {verdict(comparison, first, label)}", comparison))
    title = f"NRMSE against {first}"
    return Group(make_table(("", *names, "missing"), rows, wrap=True, title=title), *lines)


def _coloured(text: str, comparison: dict[str, Any]) -> Text:
    return Text(text, style="bold green" if comparison["identical"] else "bold red")


def _agreement(topic: dict[str, Any]) -> str:
    if not topic["compared"]:
        return "-"
    equal = all(field["max_abs"] == 0 for field in topic["fields"].values())
    return "same" if equal else small_percent(topic["nrmse"])


def _unit(topic: str, row: dict[str, Any]) -> str:
    """Look up the unit of the field that differs most; empty if it has no fixed one."""
    for field, errors in row["fields"].items():
        if errors["max_abs"] == row["max_abs"] != 0:
            return FIELD_UNITS.get((topic, field), "")
    return ""


def difference_lines(comparison: dict[str, Any], a: str = "a", b: str = "b") -> list[str]:
    """Say how two records differ, the verdict first; as `comparison_table` takes them."""
    names = {"a": a, "b": b}
    first, value = (comparison[key] for key in ("first_difference", "first_value_difference"))
    lines = [verdict(comparison, a, b) + _held(comparison["missed"], names)]
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
    alone = [
        f"{', '.join(comparison['axes'][f'only_{key}'])} only in {names[key]}"
        for key in ("a", "b")
        if comparison["axes"][f"only_{key}"]
    ]
    if alone:
        compared = ", ".join(comparison["axes"]["compared"])
        lines.append(f"axes differ: {'; '.join(alone)}; compared: {compared}")
    return lines


def verdict(comparison: dict[str, Any], a: str = "a", b: str = "b") -> str:
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


def _held(missed: dict[str, int | None], names: dict[str, str]) -> str:
    held = ", ".join(f"{missed[key]} in {names[key]}" for key in ("a", "b") if missed[key])
    return f"; steps without a command in time: {held}" if held else ""
