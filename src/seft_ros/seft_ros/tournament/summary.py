"""A tournament as a dict of JSON values: ``seft tournament --json``."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from seft_ros.analysis.summary import json_safe
from seft_ros.tournament.entries import Tournament
from seft_ros.tournament.perturbed_rig import UNCERTAINTY
from seft_ros.tournament.runs import Run
from seft_ros.tournament.standings import Standing


def summarise_tournament(
    tournament: Tournament, runs: Sequence[Run], standings: Sequence[Standing]
) -> dict[str, Any]:
    """Summarise a tournament.

    Returns
    -------
    dict
        ``rigs`` (by number: seed of the noise, and each parameter that is uncertain),
        ``standings`` (as `Standing`, best first within a mass ratio) and ``runs`` (mass_ratio,
        rig, method, engine, obstacle, and what `Run` keeps of the test's summary).
    """
    rigs = [
        {"rig": number, "seed": rig["seed"], **{name: rig[name] for name in UNCERTAINTY}}
        for number, rig in enumerate(tournament.rigs)
    ]
    found = {
        "rigs": rigs,
        "standings": [asdict(standing) for standing in standings],
        "runs": [
            run.entry._asdict() | {"engine": run.engine, "obstacle": run.obstacle} | run.summary
            for run in runs
        ],
    }
    return {key: json_safe(value) for key, value in found.items()}
