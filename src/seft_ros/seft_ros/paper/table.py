"""Claims as a table for the terminal."""

from collections.abc import Sequence

from rich.table import Table

from seft_ros.paper.claim import Claim


def claims_table(claims: Sequence[Claim], title: str) -> Table:
    """Make a table of claim, paper, ours, agrees."""
    table = Table(title=title)
    for heading in ("claim", "paper", "ours", "agrees"):
        table.add_column(heading)
    for claim in claims:
        verdict = "[green]yes[/]" if claim.agrees else "[bold red]no[/]"
        table.add_row(f"{claim.claim} ({claim.where})", claim.paper, claim.ours, verdict)
    return table
