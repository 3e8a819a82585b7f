"""A tournament for people: one table to a mass ratio."""

from collections.abc import Sequence

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from seft_ros.analysis.table import GOOD_ERROR
from seft_ros.tournament.runs import Run
from seft_ros.tournament.standings import Standing

RANKING = "ranked by share unstable, then worst NRMSE of the displacement"


def standings_table(standings: Sequence[Standing], title: str) -> Table:
    """Tabulate the methods at one mass ratio, best first.

    Parameters
    ----------
    standings : sequence of Standing
        Of one mass ratio.
    title : str
        Heading.
    """
    table = Table(
        box=SIMPLE_HEAD,  # 80 columns are enough
        show_edge=False,
        padding=(0, 1, 0, 0),
        title=Text(title),
        title_justify="left",
        title_style="",
        caption=Text(RANKING),
        caption_justify="left",
        caption_style="",
    )
    for heading in (
        "",
        "method",
        "NRMSE\nmedian",
        "\nworst",
        "peak\nerror",
        "delay",
        "unstable",
        "cost",
    ):
        left = heading in ("method", "")
        table.add_column(heading, justify="left" if left else "right", no_wrap=True)
    for standing in standings:
        if standing.not_possible is None:
            table.add_row(*_cells(standing), style=_colour(standing))
    return table


def reasons(standings: Sequence[Standing]) -> list[str]:
    """Say once why each method that is not possible is not."""
    told = {
        f"{row.method}: not possible: {row.not_possible}": None
        for row in standings
        if row.not_possible is not None
    }
    return list(told)


def plain_runs(runs: Sequence[Run]) -> list[str]:
    """Say once which methods ran on the plain blocks, and why."""
    methods: dict[str, list[str]] = {}
    for run in runs:
        if run.obstacle and run.entry.method not in methods.setdefault(run.obstacle, []):
            methods[run.obstacle].append(run.entry.method)
    return [f"{', '.join(names)}: on the plain blocks: {why}" for why, names in methods.items()]


def percent(value: float | None, sign: str = "") -> str:
    """Write a share in percent, with three digits."""
    if value is None:
        return "-"
    number = 100.0 * value
    text = f"{number:{sign}.0f}" if abs(number) >= 1000 else f"{number:{sign}#.3g}".rstrip(".")
    return f"{text} %"


def _cells(standing: Standing) -> list[str]:
    share = standing.unstable_share or 0.0
    return [
        str(standing.rank),
        standing.method,
        percent(standing.nrmse_median),
        "unstable" if share else percent(standing.nrmse_worst),
        percent(standing.peak_error, "+"),
        "-" if standing.delay_s is None else f"{1e3 * standing.delay_s:.1f} ms",
        f"{100 * share:.3g} %",
        "-" if standing.cost_s is None else f"{1e6 * standing.cost_s:.2g} µs",
    ]


def _colour(standing: Standing) -> str:
    """Red: some rig is unstable with it; green: right on every rig."""
    if standing.unstable_share:
        return "red"
    worst = standing.nrmse_worst
    return "green" if worst is not None and worst <= GOOD_ERROR else "yellow"
