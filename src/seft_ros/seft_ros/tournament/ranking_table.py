"""What a tournament found: one table to a mass ratio, and JSON values."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from seft_ros.analysis.summary import json_safe
from seft_ros.drawing.tables import GOOD_ERROR, Number, make_table
from seft_ros.tournament.entries import Tournament
from seft_ros.tournament.perturbed_rig import UNCERTAINTY
from seft_ros.tournament.runs import Run
from seft_ros.tournament.standings import Standing

RANKING = "ranked by share unstable, then worst NRMSE of the displacement"


def percent(value: float | None, sign: str = "") -> str:
    """Write a share in percent, with three digits."""
    if value is None:
        return "-"
    number = 100.0 * value
    text = f"{number:{sign}.0f}" if abs(number) >= 1000 else f"{number:{sign}#.3g}".rstrip(".")
    return f"{text} %"


_COLUMNS = (
    Number("", "rank", form=str),
    Number("method", "method"),
    Number("NRMSE\nmedian", "nrmse_median", form=percent),
    Number("\nworst", "worst", form=percent),
    Number("peak\nerror", "peak_error", form=lambda value: percent(value, "+")),
    Number("delay", "delay_s", "ms", 1e3, ".1f"),
    Number("unstable", "share", "%", 100.0, ".3g"),
    Number("cost", "cost_s", "µs", 1e6, ".2g"),
)


def standings_table(standings: Sequence[Standing], title: str) -> Table:
    """Tabulate the methods at one mass ratio, best first; green: right on every rig."""
    table = make_table(
        [column.label for column in _COLUMNS],
        (),
        left=(0, 1),
        title=Text(title),
        caption=Text(RANKING),
        box=SIMPLE_HEAD,  # 80 columns are enough
        show_edge=False,
        padding=(0, 1, 0, 0),
    )
    for standing in standings:
        if standing.not_possible is None:
            share, worst = standing.unstable_share or 0.0, standing.nrmse_worst
            colour = "green" if worst is not None and worst <= GOOD_ERROR else "yellow"
            row = asdict(standing) | {"worst": "unstable" if share else worst, "share": share}
            cells = [column.text(row) for column in _COLUMNS]
            table.add_row(*cells, style="red" if share else colour)
    return table


def reasons(standings: Sequence[Standing]) -> list[str]:
    """Say once why each method that is not possible is not."""
    without = [row for row in standings if row.not_possible is not None]
    return list(dict.fromkeys(f"{r.method}: not possible: {r.not_possible}" for r in without))


def plain_runs(runs: Sequence[Run]) -> list[str]:
    """Say once which methods ran on the plain blocks, and why."""
    methods: dict[str, list[str]] = {}
    for run in runs:
        if run.obstacle and run.entry.method not in methods.setdefault(run.obstacle, []):
            methods[run.obstacle].append(run.entry.method)
    return [f"{', '.join(names)}: on the plain blocks: {why}" for why, names in methods.items()]


def summarise_tournament(
    tournament: Tournament, runs: Sequence[Run], standings: Sequence[Standing]
) -> dict[str, Any]:
    """Summarise a tournament: ``seft tournament --json``.

    Returns
    -------
    dict
        ``rigs`` (by number: seed of the noise, and each parameter that is uncertain),
        ``standings`` (as `Standing`, best first within a mass ratio) and ``runs`` (mass_ratio,
        rig, method, engine, obstacle, and what `Run` keeps of the test's summary).
    """
    found = {
        "rigs": [
            {"rig": number, "seed": rig["seed"], **{name: rig[name] for name in UNCERTAINTY}}
            for number, rig in enumerate(tournament.rigs)
        ],
        "standings": [asdict(standing) for standing in standings],
        "runs": [
            run.entry._asdict() | {"engine": run.engine, "obstacle": run.obstacle} | run.summary
            for run in runs
        ],
    }
    return {key: json_safe(value) for key, value in found.items()}
