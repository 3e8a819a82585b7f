"""The claims and what they rest on: a table for the terminal, and JSON values."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.table import Table

from seft_ros.analysis.summary import json_safe
from seft_ros.drawing.tables import CENTRED, make_table
from seft_ros.paper.claim import Claim
from seft_ros.paper.findings import BEYOND, Findings


def claims_table(claims: Sequence[Claim], title: str) -> Table:
    """Make a table of claim, paper, ours, agrees."""
    headings = ("claim", "paper", "ours", "agrees")
    verdicts = {True: "[green]yes[/]", False: "[bold red]no[/]"}
    rows = [(f"{c.claim} ({c.where})", c.paper, c.ours, verdicts[c.agrees]) for c in claims]
    return make_table(headings, rows, left=range(4), wrap=True, title=title, **CENTRED)


def summarise_paper(found: Findings, claims: list[Claim], page: Path) -> dict[str, Any]:
    """Summarise a reproduction: ``seft paper --json``.

    Returns
    -------
    dict
        ``record`` (what moved the ground) and ``synthetic``; ``claims``, a list of claim, paper,
        ours, agrees, criterion, where and note; ``agree`` and ``disagree``, counts; ``beyond``,
        errors of the displacement with the recommended compensator; ``page``, its path.
    """
    agree = sum(claim.agrees for claim in claims)
    return {
        "record": found.source,
        "synthetic": not found.experiment["ground_motion"]["file"],
        "claims": [asdict(claim) for claim in claims],
        "agree": agree,
        "disagree": len(claims) - agree,
        "beyond": [
            {
                "mass_ratio": ratio,
                "peak_force": found.tests["target", ratio].input_peak,
                "stable": found.tests["target", ratio].stable,
                "nrmse": json_safe(found.tests["target", ratio].agreement("displacement").nrmse),
            }
            for ratio in BEYOND
        ],
        "page": str(page),
    }
