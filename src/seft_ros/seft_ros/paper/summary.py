"""The claims and what they rest on as a dict of JSON values: ``seft paper --json``."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from seft_ros.analysis.summary import json_safe
from seft_ros.paper.claim import Claim
from seft_ros.paper.findings import BEYOND, Findings


def summarise_paper(found: Findings, claims: list[Claim], page: Path) -> dict[str, Any]:
    """Summarise a reproduction.

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
