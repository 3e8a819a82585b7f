"""Maps of stability over mass ratio and dead time, and mass ratio and stiffness."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from textwrap import wrap
from timeit import timeit
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.contour import QuadContourSet
from matplotlib.figure import Figure
from seft_msgs_py.arrays import Floats

from seft_ros.design import stability_margins as margin
from seft_ros.design.planned_tests import NEUTRAL, PlannedTest
from seft_ros.design.stability_verdict import Preflight
from seft_ros.drawing.style import TEXT, new_figure

_MAP_TIME_S = 6.0
"""Time that the maps may take, s; they are coarser if a loop is large."""
_FINEST, _COARSEST = 40, 10

_LEVELS = (-30.0, -10.0, -3.0, -1.0, 0.0, 3.0, 10.0, 30.0, 100.0)
_COLOURS = (
    "#8fb8d8", "#abcae2", "#c6dbec", "#dceaf4", "#eef5fa",
    "#fbe6de", "#f6cbbb", "#efac96", "#e58a70", "#d6684f",
)  # fmt: skip
_PANELS = (
    (margin.DEAD_TIME, "dead time", "actuator's dead time / ms", 1e3),
    (margin.LOCAL_STIFFNESS, "local stiffness", margin.LOCAL_STIFFNESS, 1.0),
)
_PLAN = {"stable": "#2e7d32", "marginal": "#e08a00", "unstable": "#b00020"}


@dataclass(frozen=True)
class StabilityMap:
    """Growth rate of the loop over mass ratio and something else.

    Attributes
    ----------
    mass_ratios, others : ndarray
        Shapes (p,) and (q,), ascending.
    growth : ndarray
        Shape (q, p), 1/s.
    planned : tuple of float
        Mass ratio and the other quantity as planned.
    """

    mass_ratios: Floats
    others: Floats
    growth: Floats
    planned: tuple[float, float]


def stability_maps(
    test: PlannedTest, margins: margin.Margins, progress: margin.Progress | None = None
) -> list[StabilityMap]:
    """Map a planned test's growth rate as far as its margins reach; progress is in rows.

    Over the dead time of the actuator's path in s, and, unless the plant was identified as a
    whole or there is no stiffness, over the ratio of the specimen's local stiffness to the one that
    the method assumes.
    """
    ends = (margins.dead_time, margins.mass_ratio)
    end, critical = (part.value if part else 0.0 for part in ends)
    longest = max(2 * test.dead_time, 10 * test.dt, 1.5 * end)
    longest = min(longest, test.dead_time + float(margin.added_delays(test)[-1]))
    swept = {"dead_time": (longest, 1.0, test.dead_time)}
    own = margin.local_stiffness(test)
    if own is not None:
        swept["stiffness"] = (max(margin.STIFFEST, 1.2 * own), own, own)
    test.growth_rate(dead_time=longest)  # fills the caches
    each = timeit(lambda: test.growth_rate(dead_time=longest), number=1)
    size = int(np.clip(np.sqrt(_MAP_TIME_S / len(swept) / each), _COARSEST, _FINEST))
    shown = 2.0 * max(test.mass_ratio, 0.5)
    highest = max(shown, 1.5 * critical) if critical < 4 * shown else shown
    mass_ratios = np.linspace(0.0, highest, size)
    maps: list[StabilityMap] = []
    for name, (high, unit, planned) in swept.items():
        others, growth = np.linspace(0.0, high, size), np.empty((size, size))
        for index, other in enumerate((others / unit).tolist()):
            at = ({"mass_ratio": ratio, name: other} for ratio in mass_ratios.tolist())
            growth[index] = [test.growth_rate(**each) for each in at]
            if progress is not None:
                progress("map", size * len(maps) + index + 1, size * len(swept))
        maps.append(StabilityMap(mass_ratios, others, growth, (test.mass_ratio, planned)))
    return maps


_NARROWEST = 9.0
"""Width of a figure with room for the margins, inches."""
_LINE = 0.21
"""Height of a line of text, inches."""
_LETTERS = 12
"""Of a line of text, per inch."""
_COLUMNS = (0.0, 0.38, 0.54, 0.7, 0.87)
"""Where the columns of `HEADINGS` end, the first one where it begins."""


def preflight_figure(test: PlannedTest, found: Preflight, maps: list[StabilityMap]) -> Figure:
    """Draw the maps of a test, one panel each, and below the margins that make the verdict."""
    width = max(6.0 * len(maps), _NARROWEST)
    letters = round(_LETTERS * width)
    notes = [line for text in margin.meanings(found.ends) for line in wrap(text, letters)]
    below = _LINE * (len(found.ends) + len(notes) + 2.5)
    figure = new_figure(width, 5.6 + below)
    grid = figure.add_gridspec(2, len(maps), height_ratios=(5.6, below))
    panels = [figure.add_subplot(grid[0, place]) for place in range(len(maps))]
    for axes, area, (name, what, label, scale) in zip(panels, maps, _PANELS, strict=False):
        filled = _draw(axes, area, scale, found.verdict)
        ends = (end for end in found.ends if end.name in (name, margin.MASS_RATIO))
        _mark(axes, area, scale, ends, _PLAN[found.verdict])
        title = f"against {what}, unknown to the method"
        axes.set_title(title, loc="left", fontsize=11, color=TEXT)
        axes.set_ylabel(label, color=TEXT)
    bar = figure.colorbar(filled, ax=panels, pad=0.01, aspect=32, spacing="uniform")
    bar.set_ticks(np.arcsinh(_LEVELS).tolist(), labels=[f"{level:g}" for level in _LEVELS])
    bar.set_label("growth rate / (1/s): stable below 0, unstable above", color=TEXT)
    bar.ax.tick_params(colors=TEXT, labelsize=9, length=0)
    bar.outline.set_visible(False)
    _write(figure.add_subplot(grid[1, :]), found, notes)
    critical = found.margins.mass_ratio
    end = f"critical mass ratio {critical.value:.3g}" if critical else "no critical mass ratio"
    method = f"{test.section['compensation.method']} at mass ratio {test.mass_ratio:g}"
    title = f"preflight: {method} is {found.verdict}, {end}"
    figure.suptitle(title, fontsize=12, color=TEXT, x=0.01, ha="left")
    return figure


def _mark(
    axes: Axes, area: StabilityMap, scale: float, ends: Iterable[margin.MarginEnd], colour: str
) -> None:
    """Mark the ends that decide the verdict, and those of which the map shows nothing."""
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    for end in ends:
        if end.critical is None or not (end.decides or end.more):
            continue
        x, y = area.planned[0], scale * end.critical.value
        if end.name == margin.MASS_RATIO:
            x, y = end.critical.value, scale * area.planned[1]
        if not (left <= x <= right and low <= y <= high):
            continue
        shown = colour if end.decides else TEXT
        text = f"{margin.DECIDES} critical" if end.decides else "critical"
        text = f"{text}, {end.more}" if end.more else text
        axes.plot(x, y, "D", ms=7, mfc=shown, mec="white", clip_on=False, zorder=6)
        to_left = 0.45 * right <= x <= area.planned[0]  # where there is room
        side, off = ("right", -9) if to_left else ("left", 9)
        look: dict[str, Any] = {"ha": side, "fontsize": 9, "color": shown}
        axes.annotate(text, (x, y), (off, -4), textcoords="offset points", **look)


def _write(axes: Axes, found: Preflight, notes: Sequence[str]) -> None:
    """Write the ends of the margins under their headings, and what they mean."""
    rows = [list(margin.HEADINGS), *margin.end_texts(found.ends)]
    decide = [False, *(end.decides for end in found.ends)]
    axes.set_axis_off()
    axes.set(xlim=(0.0, 1.0), ylim=(len(rows) + len(notes) + 1.0, -0.5))
    for line, (row, decides) in enumerate(zip(rows, decide, strict=True)):
        colour, weight = (_PLAN[found.verdict], "bold") if decides else (TEXT, "normal")
        for column, (x, text) in enumerate(zip(_COLUMNS, row, strict=True)):
            side = "right" if column else "left"
            axes.text(x, line, text, ha=side, va="center", fontsize=9, color=colour, weight=weight)
    axes.axhline(0.5, color=TEXT, lw=0.8)
    for line, text in enumerate(notes, len(rows)):
        axes.text(0.0, line + 0.4, text, va="center", fontsize=9, color=TEXT, in_layout=False)


def _draw(axes: Axes, area: StabilityMap, scale: float, verdict: str) -> QuadContourSet:
    x, y = area.mass_ratios, scale * area.others
    # interpolated on a scale on which it is nearly straight across the critical line
    bent, levels = np.arcsinh(area.growth - NEUTRAL), np.arcsinh(_LEVELS)
    filled = axes.contourf(x, y, bent, levels=levels, colors=_COLOURS, extend="both")
    if bent.min() < 0 < bent.max():
        axes.contour(x, y, bent, levels=[0.0], colors=TEXT, linewidths=1.8)
    planned, colour = (area.planned[0], scale * area.planned[1]), _PLAN[verdict]
    axes.plot(*planned, "o", ms=9, mfc=colour, mec="white", mew=1.5, clip_on=False, zorder=5)
    axes.annotate("planned", planned, (9, 7), textcoords="offset points", fontsize=9, color=TEXT)
    axes.set_xlabel("mass ratio $\\alpha$", color=TEXT)
    axes.tick_params(colors=TEXT, labelsize=9)
    axes.spines[["top", "right"]].set_visible(False)
    return filled
