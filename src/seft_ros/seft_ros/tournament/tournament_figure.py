"""The figure of a tournament: the errors of all tests by method, one panel for each mass ratio."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FixedLocator, LogLocator, NullLocator

from seft_ros.drawing.style import FIRST, MARK, REFERENCE, TEXT, finish, new_figure, tidy
from seft_ros.tournament.runs import Run
from seft_ros.tournament.standings import Standing

_SMALLEST = 1e-4  # %: below, an error is drawn here
_EDGE = 0.92  # share of the width, beyond which unstable tests are marked
_DIAMOND, _CROSSES = 0.943, 0.976  # there
_ROW = 0.36  # inch
_STRIP = 0.56  # of a row, over which the rigs are spread
_NOTE: dict[str, Any] = {"fontsize": 8, "va": "center"}
_STYLES: dict[str, dict[str, Any]] = {
    "perturbed rig": {"color": FIRST, "marker": "o", "ms": 4, "mew": 0, "alpha": 0.65, "ls": ""},
    "configured rig": {"color": "white", "marker": "D", "ms": 6, "mec": TEXT, "mew": 1.2, "ls": ""},
    "median": {"color": TEXT, "marker": "|", "ms": 15, "mew": 2.0, "ls": ""},
    "unstable": {"color": MARK, "marker": "x", "ms": 4, "mew": 1.1, "ls": ""},
}


def tournament_figure(standings: Sequence[Standing], runs: Sequence[Run], title: str) -> Figure:
    """Draw the displacement error on every rig by method, best method on top.

    Parameters
    ----------
    standings : sequence of Standing
        Best first within a mass ratio.
    runs : sequence of Run
        Every test.
    title : str
        Heading.
    """
    ratios = list(dict.fromkeys(row.mass_ratio for row in standings))
    columns = 1 if len(ratios) <= 3 else 2
    rows = -(-len(ratios) // columns)
    methods = max(sum(row.mass_ratio == ratio for row in standings) for ratio in ratios)
    width, height = (9.0 if columns == 1 else 13.0), 1.3 + rows * (0.9 + _ROW * methods)
    figure = new_figure(width, height)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    # the axis holds all errors, in %, and to the right of them the unstable tests
    errors = [_percent(run.nrmse) for run in runs if run.nrmse is not None] or [1.0]
    low, edge = np.log10(min(errors)) - 0.12, np.log10(max(errors)) + 0.12
    lost = any(not run.stable for run in runs)
    high = low + (edge - low) / _EDGE if lost else edge
    locator = LogLocator(subs=(1.0,) if edge - low > 3 else (1.0, 2.0, 5.0))
    ticks = [tick for tick in locator.tick_values(10**low, 10**edge) if tick <= 10**edge]
    for panel, ratio in zip(panels, ratios, strict=False):
        own = [row for row in standings if row.mass_ratio == ratio]
        tidy(panel)
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
            middle = {"ha": "center", "va": "bottom", "fontsize": 8}
            panel.text((1.0 + _EDGE) / 2, 1.0, "unstable", **middle, **inside)
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
        text = f"{len(lost)} of {len(runs)}"
        panel.text(1.01, place, text, transform=edge, color=MARK, **_NOTE)
    if standing.not_possible is not None:
        panel.text(0.01, place, "not possible", transform=edge, color=REFERENCE, **_NOTE)


def _percent(nrmse: float) -> float:
    return max(100.0 * nrmse, _SMALLEST)
