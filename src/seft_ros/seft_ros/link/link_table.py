"""What was measured of a link, for people."""

from typing import Any

from rich.table import Table
from rich.text import Text

from seft_ros.drawing.tables import Number, make_table, rows_of

_COLOURS = {"good": "green", "marginal": "yellow", "unusable": "red"}
_LINK = (
    Number(
        "lost",
        form=lambda link: (
            f"{link['lost']} ({100 * link['lost'] / link['sent']:.3g} %), "
            f"at most {link['longest_burst']} in a row"
        ),
    ),
    Number("came out of order", "reordered", form=str),
    Number("loop_delay that it needs", "loop_delay", "steps", form=str),
    Number("rate up to which none is needed", "rate_within_a_step_hz", "Hz", form=".3g"),
)
_TEST = (
    Number("critical mass ratio", "critical_mass_ratio", form=".3g", missing="none found"),
    Number("planned mass ratio", "mass_ratio", form="g"),
)


def link_table(summary: dict[str, Any]) -> Table:
    """Tabulate the summary of `seft link`; the caption is its verdict."""
    verdict, trips, test = summary["verdict"], summary["round_trip_s"], summary["test"]
    rows = rows_of((Number(f"round trip, {name}", name, "ms", 1e3, ".3f") for name in trips), trips)
    rows += rows_of(_LINK, summary)
    if test is not None:
        unknown = {"critical_mass_ratio": "unknown"} if test["unknown"] else {}
        rows += rows_of(_TEST, test | unknown)
    return make_table(
        ("", ""),
        rows,
        left=(0, 1),
        wrap=True,
        show_header=False,
        title=f"link: {summary['sent']} messages of {summary['size_bytes']} bytes at "
        f"{summary['rate_hz']:g} Hz",
        caption=Text(verdict, style=f"bold {_COLOURS[verdict]}"),
    )
