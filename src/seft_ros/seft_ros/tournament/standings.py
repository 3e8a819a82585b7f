"""How the methods of a tournament did, best first: ranking, tables, JSON values."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from statistics import median
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from seft_ros.drawing.tables import GOOD_ERROR, Number, json_safe, make_table, percent
from seft_ros.tournament.entries import UNCERTAINTY, Tournament
from seft_ros.tournament.runs import Run

RANKING = "ranked by share unstable, then worst NRMSE of the displacement"


@dataclass(frozen=True)
class Standing:
    """One method at one mass ratio, over all rigs.

    Errors are those of the displacement, without any shift, of the stable tests.

    Attributes
    ----------
    mass_ratio : float
        Of its tests.
    method : str
        Compensation method.
    rank : int or None
        From 1 on; methods that do equally well share it. None: not possible.
    nrmse_configured : float or None
        Error on the configured rig; None where it was unstable.
    nrmse_median : float or None
        Median over the stable tests; None: there is none.
    nrmse_worst : float or None
        Largest error; None where a test was unstable.
    peak_error : float or None
        (peak - exact peak) / exact peak where it is largest in magnitude.
    delay_s : float or None
        Median of the best-fit delays of the displacement, s.
    unstable_share : float or None
        Share of the tests that tripped or went beyond all numbers.
    cost_s : float or None
        Time of a step, s.
    not_possible : str or None
        Why the method could not be set up.
    """

    mass_ratio: float
    method: str
    rank: int | None = None
    nrmse_configured: float | None = None
    nrmse_median: float | None = None
    nrmse_worst: float | None = None
    peak_error: float | None = None
    delay_s: float | None = None
    unstable_share: float | None = None
    cost_s: float | None = None
    not_possible: str | None = None


_COLUMNS = (
    Number("", "rank", form=str),
    Number("method", "method"),
    Number("NRMSE\nmedian", "nrmse_median", form=percent),
    Number("\nworst", "nrmse_worst", form=percent),
    Number("peak\nerror", "peak_error", form=lambda value: percent(value, "+")),
    Number("delay", "delay_s", "ms", 1e3, ".1f"),
    Number("unstable", "unstable_share", "%", 100.0, ".3g"),
    Number("cost", "cost_s", "µs", 1e6, ".2g"),
)


def standings(
    tournament: Tournament, runs: Sequence[Run], costs: Mapping[tuple[float, str], float]
) -> list[Standing]:
    """Rank the methods of each mass ratio by their worst case.

    The fewer tests of a method were unstable the better; of those with as many, the smaller
    largest error is better, or, where some were unstable, the smaller median. Methods that are
    not possible come last.

    Parameters
    ----------
    tournament : Tournament
        Who took part.
    runs : sequence of Run
        Every test of it.
    costs : mapping
        (mass ratio, method) -> time of a step, s.
    """
    found: list[Standing] = []
    for ratio in tournament.mass_ratios:
        ranked, left_out = [], []
        for method in tournament.methods:
            reason = tournament.not_possible.get((ratio, method))
            if reason is not None:
                left_out.append(Standing(ratio, method, not_possible=reason))
                continue
            own = [run for run in runs if run.entry[::2] == (ratio, method)]
            ranked.append(_standing(own, costs.get((ratio, method))))
        ranked.sort(key=_badness)
        badness = [_badness(row) for row in ranked]
        found += [replace(row, rank=1 + badness.index(_badness(row))) for row in ranked]
        found += left_out
    return found


def _standing(runs: Sequence[Run], cost: float | None) -> Standing:
    """Sum the tests of one method at one mass ratio up."""
    stable = [run.summary["displacement"] for run in runs if run.stable]
    errors, delays = (
        [part[key] for part in stable if part[key] is not None] for key in ("nrmse", "delay_s")
    )
    peaks = [
        part["peak"] / part["reference_peak"] - 1.0 for part in stable if part["reference_peak"]
    ]
    return Standing(
        mass_ratio=runs[0].entry.mass_ratio,
        method=runs[0].entry.method,
        nrmse_configured=next((run.nrmse for run in runs if run.entry.rig == 0), None),
        nrmse_median=median(errors) if errors else None,
        nrmse_worst=max(errors) if len(errors) == len(runs) else None,
        peak_error=max(peaks, key=abs, default=None),
        delay_s=median(delays) if delays else None,
        unstable_share=1.0 - len(stable) / len(runs),
        cost_s=cost,
    )


def _badness(standing: Standing) -> list[float]:
    values = (standing.unstable_share, standing.nrmse_worst, standing.nrmse_median)
    return [math.inf if value is None else value for value in values]


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
            row, worst = asdict(standing), standing.nrmse_worst
            style = "green" if worst is not None and worst <= GOOD_ERROR else "yellow"
            if standing.unstable_share:
                style, row["nrmse_worst"] = "red", "unstable"
            table.add_row(*(column.text(row) for column in _COLUMNS), style=style)
    return table


def notes(standings: Sequence[Standing], runs: Sequence[Run]) -> list[str]:
    """Say why methods are not possible, and which ran on the uncompiled blocks and why."""
    said = {
        f"{row.method}: not possible: {row.not_possible}": None
        for row in standings
        if row.not_possible is not None
    }
    methods: dict[str, dict[str, None]] = {}
    for run in runs:
        if run.obstacle:
            methods.setdefault(run.obstacle, {})[run.entry.method] = None
    plain = [f"{', '.join(names)}: on the plain blocks: {why}" for why, names in methods.items()]
    return [*said, *plain]


def summarise_tournament(
    tournament: Tournament, runs: Sequence[Run], standings: Sequence[Standing]
) -> dict[str, Any]:
    """Summarise a tournament: ``seft tournament --json``.

    Returns
    -------
    dict
        ``rigs`` (by number: seed of the noise, and each parameter that is uncertain),
        ``standings`` (as `Standing`, best first within a mass ratio) and ``runs`` (mass_ratio,
        rig, method, engine, obstacle, and the test's summary of `Run`).
    """
    found: dict[str, Any] = json_safe(
        {
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
    )
    return found
