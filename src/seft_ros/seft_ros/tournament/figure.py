"""A figure of a tournament: the errors of all tests by method, one panel to a mass ratio."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FixedLocator, LogLocator, NullLocator

from seft_ros.drawing.style import FIRST, MARK, REFERENCE, TEXT, legend_below, tidy
from seft_ros.tournament.runs import Run
from seft_ros.tournament.standings import Standing

Floats = npt.NDArray[np.float64]

_SMALLEST = 1e-4  # %: below, an error is drawn here
_EDGE = 0.92  # share of the width, beyond which unstable tests are marked
_DIAMOND, _CROSSES = 0.943, 0.976  # there
_ROW = 0.36  # inch
_STRIP = 0.56  # of a row, over which the rigs are spread
_NOTE: dict[str, Any] = {"fontsize": 8, "va": "center"}


class _Limits(NamedTuple):
    """Axis of errors in %: from low to edge; up to high for tests that have none."""

    low: float
    edge: float
    high: float


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
    figure = Figure(
        figsize=(9.0 if columns == 1 else 13.0, 1.3 + rows * (0.9 + _ROW * methods)),
        layout="constrained",
    )
    FigureCanvasAgg(figure)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    limits = _limits(runs)
    for panel, ratio in zip(panels, ratios, strict=False):
        own = [row for row in standings if row.mass_ratio == ratio]
        _dress(panel, limits, own)
        for place, standing in enumerate(own):
            _draw(panel, place, standing, [run for run in runs if run.entry[::2] == _key(standing)])
    for panel in panels[len(ratios) :]:
        panel.remove()
    for panel in panels[: len(ratios)][-columns:]:
        panel.set_xlabel("NRMSE of displacement / %", color=TEXT)
    legend_below(figure, _legend(panels[0]), 4, fontsize=9)
    figure.suptitle(title, fontsize=11, color=TEXT, parse_math=False)
    return figure


def _draw(panel: Axes, place: int, standing: Standing, runs: Sequence[Run]) -> None:
    heights = _heights(max((run.entry.rig for run in runs), default=0))
    known = [run for run in runs if run.nrmse is not None]
    errors = {run.entry.rig: _percent(run.nrmse or 0.0) for run in known}
    others = [rig for rig in errors if rig]
    if errors:
        span = min(errors.values()), max(errors.values())
        panel.plot(span, (place, place), color=REFERENCE, lw=5, alpha=0.35, solid_capstyle="round")
    panel.plot([errors[rig] for rig in others], place + heights[others], **_STYLES["perturbed rig"])
    if 0 in errors:
        panel.plot(errors[0], place, **_STYLES["configured rig"])
    if standing.nrmse_median is not None:
        panel.plot(_percent(standing.nrmse_median), place, **_STYLES["median"])
    edge = panel.get_yaxis_transform()
    lost = [run.entry.rig for run in runs if not run.stable]
    if lost:
        crosses = [rig for rig in lost if rig]
        places = place + heights[crosses]
        panel.plot(np.full(len(crosses), _CROSSES), places, transform=edge, **_STYLES["unstable"])
        if 0 in lost:
            style = _STYLES["configured rig"] | {"mec": MARK}
            panel.plot(_DIAMOND, place, transform=edge, **style)
        text = f"{len(lost)} of {len(runs)}"
        panel.text(1.01, place, text, transform=edge, color=MARK, **_NOTE)
    if standing.not_possible is not None:
        panel.text(0.01, place, "not possible", transform=edge, color=REFERENCE, **_NOTE)


_STYLES: dict[str, dict[str, Any]] = {
    "perturbed rig": {"color": FIRST, "marker": "o", "ms": 4, "mew": 0, "alpha": 0.65, "ls": ""},
    "configured rig": {"color": "white", "marker": "D", "ms": 6, "mec": TEXT, "mew": 1.2, "ls": ""},
    "median": {"color": TEXT, "marker": "|", "ms": 15, "mew": 2.0, "ls": ""},
    "unstable": {"color": MARK, "marker": "x", "ms": 4, "mew": 1.1, "ls": ""},
}


def _heights(last: int) -> Floats:
    """Where to draw each rig in a row, the configured one in the middle, shape (last + 1,)."""
    others = np.linspace(-0.5, 0.5, last) if last > 1 else np.zeros(last)
    return _STRIP * np.concatenate([[0.0], others])


def _dress(panel: Axes, limits: _Limits, standings: Sequence[Standing]) -> None:
    tidy(panel)
    panel.set_xscale("log")
    panel.set_xlim(limits.low, limits.high)
    wide = np.log10(limits.edge / limits.low) > 3
    locator = LogLocator(subs=(1.0,) if wide else (1.0, 2.0, 5.0))
    ticks = [tick for tick in locator.tick_values(limits.low, limits.edge) if tick <= limits.edge]
    panel.xaxis.set_major_locator(FixedLocator(ticks))
    panel.xaxis.set_minor_locator(NullLocator())
    panel.xaxis.set_major_formatter("{x:g}")
    panel.set_ylim(len(standings) - 0.5, -0.5)
    panel.set_yticks(range(len(standings)), [row.method for row in standings])
    panel.grid(visible=False, axis="y")
    panel.tick_params(axis="y", length=0)
    for label, row in zip(panel.get_yticklabels(), standings, strict=True):
        label.set_color(TEXT if row.not_possible is None else REFERENCE)
    panel.set_title(f"mass ratio {standings[0].mass_ratio:g}", loc="left", fontsize=11, color=TEXT)
    if limits.edge < limits.high:
        where = (_EDGE, 0.0), 1.0 - _EDGE, 1.0
        panel.add_patch(Rectangle(*where, transform=panel.transAxes, color=MARK, alpha=0.06, lw=0))
        panel.text(
            (1.0 + _EDGE) / 2, 1.0, "unstable", transform=panel.transAxes, color=MARK, fontsize=8,
            ha="center", va="bottom",
        )  # fmt: skip


def _limits(runs: Sequence[Run]) -> _Limits:
    """Axis that holds all errors, and to the right of them the unstable tests."""
    errors = [_percent(run.nrmse) for run in runs if run.nrmse is not None] or [1.0]
    low, edge = np.log10(min(errors)) - 0.12, np.log10(max(errors)) + 0.12
    lost = any(not run.stable for run in runs)
    high = low + (edge - low) / _EDGE if lost else edge
    return _Limits(*(float(10**end) for end in (low, edge, high)))


def _legend(panel: Axes) -> dict[str, Any]:
    return {name: panel.plot([], [], label=name, **style)[0] for name, style in _STYLES.items()}


def _percent(nrmse: float) -> float:
    return max(100.0 * nrmse, _SMALLEST)


def _key(standing: Standing) -> tuple[float, str]:
    return standing.mass_ratio, standing.method
