"""What was measured of a link, for people."""

from typing import Any

from rich.table import Table
from rich.text import Text

_COLOURS = {"good": "green", "marginal": "yellow", "unusable": "red"}


def link_table(summary: dict[str, Any]) -> Table:
    """Tabulate the summary of `seft link`; the caption is its verdict."""
    verdict, trips, test = summary["verdict"], summary["round_trip_s"], summary["test"]
    table = Table(
        show_header=False,
        title=f"link: {summary['sent']} messages of {summary['size_bytes']} bytes at "
        f"{summary['rate_hz']:g} Hz",
        title_justify="left",
        title_style="",
        caption=Text(verdict, style=f"bold {_COLOURS[verdict]}"),
        caption_justify="left",
        caption_style="",
    )
    for name, value in trips.items():
        table.add_row(f"round trip, {name}", f"{1e3 * value:.3f} ms")
    lost = f"{summary['lost']} ({100 * summary['lost'] / summary['sent']:.3g} %)"
    table.add_row("lost", f"{lost}, at most {summary['longest_burst']} in a row")
    table.add_row("came out of order", str(summary["reordered"]))
    table.add_row("loop_delay that it needs", f"{summary['loop_delay']} steps")
    table.add_row("rate up to which none is needed", f"{summary['rate_within_a_step_hz']:.3g} Hz")
    if test is not None:
        critical = test["critical_mass_ratio"]
        told = "none found" if critical is None else f"{critical:.3g}"
        table.add_row("critical mass ratio", "unknown" if test["unknown"] else told)
        table.add_row("planned mass ratio", f"{test['mass_ratio']:g}")
    return table
