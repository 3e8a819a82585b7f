"""How the methods of a tournament did, best first: ranking, tables, figure, JSON values."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from statistics import median
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator
from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text
from seft_msgs_py.arrays import Floats

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
_ROW = 0.36  # inch
_STRIP = 0.56  # of a row, over which the rigs are spread
_NOTE: dict[str, Any] = {"fontsize": 8, "va": "center"}
_STYLES: dict[str, dict[str, Any]] = {
    "perturbed rig": {"color": FIRST, "marker": "o", "ms": 4, "mew": 0, "alpha": 0.65, "ls": ""},
    "configured rig": {"color": "white", "marker": "D", "ms": 6, "mec": TEXT, "mew": 1.2, "ls": ""},
    "median": {"color": TEXT, "marker": "|", "ms": 15, "mew": 2.0, "ls": ""},
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
    not_possible: str | None = None


_COLUMNS = (
    Number("", "rank", form=str),
    Number("method", "method"),
    Number("NRMSE\nmedian", "nrmse_median", form=percent),
    Number("\nworst", "nrmse_worst", form=percent),
    Number("peak\nerror", "peak_error", form=lambda value: percent(value, "+")),
    Number("delay", "delay_s", "ms", 1e3, ".1f"),
    Number("unstable", "unstable_share", "%", 100.0, ".3g"),
)


def standings(tournament: Tournament, runs: Sequence[Run]) -> list[Standing]:
    """Rank the methods of each mass ratio by their worst case.

    The fewer tests of a method were unstable the better; of those with as many, the smaller
    largest error is better, or, where some were unstable, the smaller median. Methods that are
    not possible come last.

    ``runs`` is every test of the tournament.
    """
    found: list[Standing] = []
    for ratio in tournament.mass_ratios:
        ranked, left_out = [], []
        for method in tournament.methods:
            reason = tournament.not_possible.get((ratio, method))
            if reason is not None:
                left_out.append(Standing(ratio, method, not_possible=reason))
                continue
            ranked.append(_standing([run for run in runs if run.entry[::2] == (ratio, method)]))
        ranked.sort(key=_badness)
        badness = [_badness(row) for row in ranked]
        found += [replace(row, rank=1 + badness.index(_badness(row))) for row in ranked]
        found += left_out
    return found


def _standing(runs: Sequence[Run]) -> Standing:
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
    """Say why methods are not possible, and which were simulated uncompiled and why."""
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
    slow = [f"{', '.join(names)}: simulated uncompiled: {why}" for why, names in methods.items()]
    return [*said, *slow]


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
    """Draw the displacement error of every stable run by method; ``standings`` are best first."""
    ratios = list(dict.fromkeys(row.mass_ratio for row in standings))
    figure = new_figure(9.0, 1.3 + 0.9 * len(ratios) + _ROW * len(standings))
    panels = figure.subplots(len(ratios), squeeze=False).ravel()
    errors = _percents(runs)
    errors = errors[np.isfinite(errors)] if np.isfinite(errors).any() else np.ones(1)
    low, high = 0.75 * errors.min(), 1.3 * errors.max()
    for panel, ratio in zip(panels, ratios, strict=True):
        own = [row for row in standings if row.mass_ratio == ratio]
        tidy(panel)
        panel.set_title(f"mass ratio {ratio:g}", loc="left", fontsize=11, color=TEXT)
        panel.set_xlabel("NRMSE of displacement / %", color=TEXT)
        panel.set_xscale("log")
        panel.set_xlim(low, high)
        panel.xaxis.set_major_locator(LogLocator(subs=(1,) if high > 1e3 * low else (1, 2, 5)))
        panel.xaxis.set_minor_locator(NullLocator())
        panel.xaxis.set_major_formatter("{x:g}")
        panel.set_ylim(len(own) - 0.5, -0.5)
        panel.set_yticks(range(len(own)), [row.method for row in own])
        panel.grid(visible=False, axis="y")
        panel.tick_params(axis="y", length=0)
        for place, row in enumerate(own):
            key = row.mass_ratio, row.method
            _draw(panel, place, row, [run for run in runs if run.entry[::2] == key])
    for name, style in _STYLES.items():
        panels[0].plot([], [], label=name, **style)
    finish(figure, panels[:1], title)
    return figure


def _draw(panel: Axes, place: int, standing: Standing, runs: Sequence[Run]) -> None:
    """Draw all tests of a method in its row, the configured rig in the middle of it."""
    edge = panel.get_yaxis_transform()
    if standing.not_possible is not None:
        panel.text(0.01, place, "not possible", transform=edge, color=REFERENCE, **_NOTE)
        return
    rigs, errors = np.array([run.entry.rig for run in runs]), _percents(runs)
    heights = place + _STRIP * np.where(rigs == 0, 0.0, rigs / (rigs.max() + 1) - 0.5)
    known = np.isfinite(errors)
    if known.any():
        span = errors[known].min(), errors[known].max()
        panel.plot(span, (place, place), color=REFERENCE, lw=5, alpha=0.35, solid_capstyle="round")
        for shown, style in ((rigs > 0, "perturbed rig"), (rigs == 0, "configured rig")):
            panel.plot(errors[known & shown], heights[known & shown], **_STYLES[style])
        panel.plot(np.median(errors[known]), place, **_STYLES["median"])
    unstable = sum(not run.stable for run in runs)
    if unstable:
        share = f"{unstable} of {len(runs)} unstable"
        panel.text(1.01, place, share, transform=edge, color=MARK, **_NOTE)


def _percents(runs: Sequence[Run]) -> Floats:
    """Errors of tests, %; NaN where there is none."""
    return np.maximum(100.0 * np.array([run.nrmse for run in runs], dtype=float), _SMALLEST)
