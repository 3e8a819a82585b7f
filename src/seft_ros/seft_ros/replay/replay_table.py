"""A replay in words: the verdict, and where an answer first differs."""

from typing import Any

from rich.console import Group
from rich.text import Text

from seft_ros.analysis.result_text import FIELD_UNITS
from seft_ros.drawing.tables import make_table, number, small_percent


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
    """Tabulate how the answers of a node differ from the recorded ones; the verdict below."""
    rate = result["answered"] / result["wall_s"] if result["wall_s"] else 0.0
    groups = {result["topic"]: result["fields"]}
    if result["estimates"] is not None:
        groups["estimates"] = result["estimates"]["fields"]
    rows = [
        [
            f"{topic} {name}",
            f"{number(row['max_abs'], form='.3g')} {FIELD_UNITS.get((topic, name), '')}".strip(),
            small_percent(row["nrmse"]),
        ]
        for topic, fields in groups.items()
        for name, row in fields.items()
    ]
    title = (
        f"{result['node']}: {result['answered']} of {result['steps']} answers, {rate:.0f} a second"
    )
    table = make_table(("answers", "largest\ndifference", "NRMSE"), rows, title=title)
    colour = "green" if result["identical"] else "red"
    return Group(table, Text(verdict(result), style=f"bold {colour}"))
