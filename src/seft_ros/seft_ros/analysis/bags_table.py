"""Several bags for people: what each is, and how each differs from the first."""

from typing import Any

from rich.console import Group
from rich.table import Table
from rich.text import Text
from seft_msgs_py.wire.topics import LOOP_TOPICS

from seft_ros.analysis.compare import length_s
from seft_ros.analysis.difference_text import verdict
from seft_ros.analysis.table import small_percent
from seft_ros.analysis.title import title_of
from seft_ros.recording.bag_reader import UNDECODABLE
from seft_ros.recording.record import Record


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


def comparisons_table(comparisons: list[dict[str, Any]], labels: list[str]) -> Group:
    """Tabulate how further records differ from the first: NRMSE by topic; verdicts below.

    Parameters
    ----------
    comparisons : list of dict
        Of each further record with the first, as `seft_ros.analysis.compare.compare` gives it.
    labels : list of str
        What the records are called, the first included.
    """
    first, *others = labels
    table = Table(title=f"NRMSE against {first}", title_justify="left", title_style="")
    table.add_column("")
    names = [topic.name for topic in LOOP_TOPICS]
    for name in (*names, "missing"):
        table.add_column(name, justify="right")
    for label, comparison in zip(others, comparisons, strict=True):
        topics = comparison["topics"]
        missing = sum(row["missing_b"] for row in topics.values())
        table.add_row(label, *(_agreement(topics[name]) for name in names), str(missing))
    lines = [
        Text(
            f"{label}: {verdict(comparison, first, label)}",
            style="bold green" if comparison["identical"] else "bold red",
        )
        for label, comparison in zip(others, comparisons, strict=True)
    ]
    return Group(table, *lines)


def _agreement(topic: dict[str, Any]) -> str:
    if not topic["compared"]:
        return "-"
    equal = all(field["max_abs"] == 0 for field in topic["fields"].values())
    return "same" if equal else small_percent(topic["nrmse"])
