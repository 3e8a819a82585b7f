"""A replay in words: the verdict, and where an answer first differs."""

from typing import Any

from rich.console import Group
from rich.table import Table
from rich.text import Text
from seft_msgs_py.wire.topics import LOOP_TOPICS, TARGET

from seft_ros.analysis.table import small_percent

_UNITS = {
    (topic.name, quantity): unit
    for topic in (*LOOP_TOPICS, TARGET)
    for quantity, unit in zip(topic.quantities, topic.units, strict=True)
}


def verdict(result: dict[str, Any]) -> str:
    """Say in one line whether a node answered as recorded, see `seft_ros.replay.verdict.judge`."""
    node, first = result["node"], result["first_difference"]
    if first is None:
        return f"{node}: {result['steps']} answers identical, bit for bit"
    where = f"{node}: first difference at step {first['step']} ({first['time_s']:g} s)"
    if first["field"] is None:
        return f"{where}: {first['topic']} is {first['replayed']}, but was {first['recorded']}"
    return (
        f"{where}, {first['topic']}, {first['field']} of axis {first['axis']}: recorded "
        f"{first['recorded']!r}, replayed {first['replayed']!r}"
    )


def replay_table(result: dict[str, Any]) -> Group:
    """Tabulate how the answers of a node differ from the recorded ones; the verdict below.

    Parameters
    ----------
    result : dict
        As `seft_ros.replay.verdict.judge` gives it.
    """
    rate = result["answered"] / result["wall_s"] if result["wall_s"] else 0.0
    counts = f"{result['answered']} of {result['steps']} answers, {rate:.0f} a second"
    table = Table(title=f"{result['node']}: {counts}", title_justify="left", title_style="")
    table.add_column("answers", no_wrap=True)
    table.add_column("largest\ndifference", justify="right", no_wrap=True)
    table.add_column("NRMSE", justify="right", no_wrap=True)
    groups = [(result["topic"], result["fields"])]
    if result["estimates"] is not None:
        groups.append(("estimates", result["estimates"]["fields"]))
    for topic, fields in groups:
        for name, row in fields.items():
            largest = "-" if row["max_abs"] is None else f"{row['max_abs']:.3g}"
            unit = _UNITS.get((topic, name), "")
            error = "-" if row["nrmse"] is None else small_percent(row["nrmse"])
            table.add_row(f"{topic} {name}", f"{largest} {unit}".strip(), error)
    colour = "green" if result["identical"] else "red"
    return Group(table, Text(verdict(result), style=f"bold {colour}"))
