"""How the methods of a tournament did, best first: ranking, tables, figure, JSON values."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from statistics import median
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FixedLocator, LogLocator, NullLocator
from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from seft_ros.drawing.style import (
    FIRST,
    GOOD_ERROR,
    MARK,
    REFERENCE,
    TEXT,
    Number,
    finish,
    json_safe,
    make_table,
    new_figure,
    percent,
    tidy,
)
from seft_ros.ensemble.entries import UNCERTAINTY, Tournament
from seft_ros.ensemble.runs import Run

RANKING = "ranked by share unstable, then worst NRMSE of the displacement"

_SMALLEST = 1e-4  # %: below, an error is drawn here
_EDGE = 0.92  # share of the width, beyond which unstable tests are marked
_DIAMOND, _CROSSES = 0.943, 0.976
_ROW = 0.36  # inch
_STRIP = 0.56  # of a row, over which the rigs are spread
_NOTE: dict[str, Any] = {"fontsize": 8, "va": "center"}
_STYLES: dict[str, dict[str, Any]] = {
    "perturbed rig": {"color": FIRST, "marker": "o", "ms": 4, "mew": 0, "alpha": 0.65, "ls": ""},
    "configured rig": {"color": "white", "marker": "D", "ms": 6, "mec": TEXT, "mew": 1.2, "ls": ""},
    "median": {"color": TEXT, "marker": "|", "ms": 15, "mew": 2.0, "ls": ""},
    "unstable": {"color": MARK, "marker": "x", "ms": 4, "mew": 1.1, "ls": ""},
}


@dataclass(frozen=True)
class Standing:
    """One method at one mass ratio, over all rigs.

    Errors are those of the displacement, without any shift, of the stable tests.

    Attributes
    ----------
    mass_ratio, method : float, str
        Of its tests.
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
        Share of the tests that tripped or have samples that are not finite.
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

    ``runs`` is every test of the tournament, ``costs`` maps (mass ratio, method) to the time of a
    step, s.
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
    lacking: dict[str, list[str]] = {}
    for row in standings:
        if row.not_possible is not None:
            why = row.not_possible.replace(f"compensation.method {row.method}", "each")
            lacking.setdefault(why, []).append(row.method)
    said = [f"{', '.join(names)}: not possible: {why}" for why, names in lacking.items()]
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


def tournament_figure(standings: Sequence[Standing], runs: Sequence[Run], title: str) -> Figure:
    """Draw the displacement error of every run by method; ``standings`` are best first."""
    ratios = list(dict.fromkeys(row.mass_ratio for row in standings))
    columns = 1 if len(ratios) <= 3 else 2
    rows = -(-len(ratios) // columns)
    methods = max(sum(row.mass_ratio == ratio for row in standings) for ratio in ratios)
    width = 9.0 if columns == 1 else 13.0
    figure = new_figure(width, 1.3 + rows * (0.9 + _ROW * methods))
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    # the axis holds all errors, in %, and to the right of them the unstable tests
    errors = [_percent(run.nrmse) for run in runs if run.nrmse is not None] or [1.0]
    low, edge = np.log10(min(errors)) - 0.12, np.log10(max(errors)) + 0.12
    lost = any(not run.stable for run in runs)
    high = low + (edge - low) / _EDGE if lost else edge
    locator = LogLocator(subs=(1.0,) if edge - low > 3 else (1.0, 2.0, 5.0))
    ticks = [tick for tick in locator.tick_values(10**low, 10**edge) if tick <= 10**edge]
    for panel, ratio in zip(panels, ratios, strict=False):
        tidy(panel)
        own = [row for row in standings if row.mass_ratio == ratio]
        panel.set_xscale("log")
        panel.set_xlim(10**low, 10**high)
        panel.xaxis.set_major_locator(FixedLocator(ticks))
        panel.xaxis.set_minor_locator(NullLocator())
        panel.xaxis.set_major_formatter("{x:g}")
        _draw_rows(panel, own)
        panel.set_title(f"mass ratio {ratio:g}", loc="left", fontsize=11, color=TEXT)
        if lost:
            inside: dict[str, Any] = {"transform": panel.transAxes, "color": MARK}
            panel.add_patch(Rectangle((_EDGE, 0.0), 1.0 - _EDGE, 1.0, alpha=0.06, lw=0, **inside))
            panel.text((1.0 + _EDGE) / 2, 1.0, "unstable", ha="center", fontsize=8, **inside)
        for place, row in enumerate(own):
            key = row.mass_ratio, row.method
            _draw(panel, place, row, [run for run in runs if run.entry[::2] == key])
    for panel in panels[len(ratios) :]:
        panel.remove()
    for panel in panels[: len(ratios)][-columns:]:
        panel.set_xlabel("NRMSE of displacement / %", color=TEXT)
    for name, style in _STYLES.items():
        panels[0].plot([], [], label=name, **style)
    finish(figure, panels[:1], title)
    return figure


def _draw_rows(panel: Axes, standings: Sequence[Standing]) -> None:
    """Name the methods, best on top."""
    panel.set_ylim(len(standings) - 0.5, -0.5)
    panel.set_yticks(range(len(standings)), [row.method for row in standings])
    panel.grid(visible=False, axis="y")
    panel.tick_params(axis="y", length=0)
    for label, row in zip(panel.get_yticklabels(), standings, strict=True):
        label.set_color(TEXT if row.not_possible is None else REFERENCE)


def _draw(panel: Axes, place: int, standing: Standing, runs: Sequence[Run]) -> None:
    """Draw all tests of a method in its row, the configured rig in the middle of it."""
    last = max((run.entry.rig for run in runs), default=0)
    others = np.linspace(-0.5, 0.5, last) if last > 1 else np.zeros(last)
    heights = place + _STRIP * np.concatenate([[0.0], others])
    errors = {run.entry.rig: _percent(run.nrmse) for run in runs if run.nrmse is not None}
    if errors:
        span = min(errors.values()), max(errors.values())
        panel.plot(span, (place, place), color=REFERENCE, lw=5, alpha=0.35, solid_capstyle="round")
    rigs = [rig for rig in errors if rig]
    panel.plot([errors[rig] for rig in rigs], heights[rigs], **_STYLES["perturbed rig"])
    if 0 in errors:
        panel.plot(errors[0], place, **_STYLES["configured rig"])
    if standing.nrmse_median is not None:
        panel.plot(_percent(standing.nrmse_median), place, **_STYLES["median"])
    edge = panel.get_yaxis_transform()
    lost = [run.entry.rig for run in runs if not run.stable]
    if lost:
        rigs = [rig for rig in lost if rig]
        crosses = np.full(len(rigs), _CROSSES)
        panel.plot(crosses, heights[rigs], transform=edge, **_STYLES["unstable"])
        if 0 in lost:
            panel.plot(_DIAMOND, place, transform=edge, **_STYLES["configured rig"] | {"mec": MARK})
        share = f"{len(lost)} of {len(runs)}"
        panel.text(1.01, place, share, transform=edge, color=MARK, **_NOTE)
    if standing.not_possible is not None:
        panel.text(0.01, place, "not possible", transform=edge, color=REFERENCE, **_NOTE)


def _percent(nrmse: float) -> float:
    return max(100.0 * nrmse, _SMALLEST)
