"""Maps of stability over mass ratio and dead time, and mass ratio and stiffness."""

from dataclasses import dataclass
from timeit import timeit

import numpy as np
from matplotlib.axes import Axes
from matplotlib.contour import QuadContourSet
from matplotlib.figure import Figure
from seft_msgs_py.arrays import Floats

from seft_ros.design import stability_margins
from seft_ros.design.plan import Plan
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
    ("against dead time, unknown to the method", "dead time of the actuator's path / ms", 1e3),
    ("against local stiffness, unknown to the method", "local stiffness / assumed stiffness", 1.0),
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
    plan: Plan,
    margins: stability_margins.Margins,
    progress: stability_margins.Progress | None = None,
) -> list[StabilityMap]:
    """Map a plan's growth rate as far as its margins reach; progress is in rows.

    Over the dead time of the actuator's path in s, and, unless the plant was identified as a
    whole or there is no stiffness, over the ratio of the specimen's local stiffness to the one that
    the method assumes.
    """
    ends = (margins.dead_time, margins.mass_ratio)
    end, critical = (part.value if part else 0.0 for part in ends)
    longest = max(2 * plan.dead_time, 10 * plan.dt, 1.5 * end)
    longest = min(longest, plan.dead_time + float(stability_margins.added_delays(plan)[-1]))
    swept = {"dead_time": (longest, 1.0, plan.dead_time)}
    own = stability_margins.local_stiffness(plan) if plan.rig.swept else None
    if own is not None:
        swept["stiffness"] = (max(stability_margins.STIFFEST, 1.2 * own), own, own)
    plan.growth_rate(dead_time=longest)  # fills the caches
    each = timeit(lambda: plan.growth_rate(dead_time=longest), number=1)
    size = int(np.clip(np.sqrt(_MAP_TIME_S / len(swept) / each), _COARSEST, _FINEST))
    shown = 2.0 * max(plan.mass_ratio, 0.5)
    highest = max(shown, 1.5 * critical) if critical < 4 * shown else shown
    mass_ratios = np.linspace(0.0, highest, size)
    maps: list[StabilityMap] = []
    for name, (high, unit, planned) in swept.items():
        others, growth = np.linspace(0.0, high, size), np.empty((size, size))
        for index, other in enumerate((others / unit).tolist()):
            growth[index] = [
                plan.growth_rate(mass_ratio=ratio, **{name: other})
                for ratio in mass_ratios.tolist()
            ]
            if progress is not None:
                progress("map", size * len(maps) + index + 1, size * len(swept))
        maps.append(StabilityMap(mass_ratios, others, growth, (plan.mass_ratio, planned)))
    return maps


def preflight_figure(plan: Plan, found: Preflight, maps: list[StabilityMap]) -> Figure:
    """Draw the maps of a plan, one panel each."""
    figure = new_figure(6.0 * len(maps), 5.6)
    panels = figure.subplots(1, len(maps), squeeze=False)[0]
    for axes, area, (title, label, scale) in zip(panels, maps, _PANELS, strict=False):
        filled = _draw(axes, area, scale, found.verdict)
        axes.set_title(title, loc="left", fontsize=11, color=TEXT)
        axes.set_ylabel(label, color=TEXT)
    bar = figure.colorbar(filled, ax=panels.tolist(), pad=0.01, aspect=32, spacing="uniform")
    bar.set_ticks(np.arcsinh(_LEVELS).tolist(), labels=[f"{level:g}" for level in _LEVELS])
    bar.set_label("growth rate / (1/s): stable below 0, unstable above", color=TEXT)
    bar.ax.tick_params(colors=TEXT, labelsize=9, length=0)
    bar.outline.set_visible(False)
    critical = found.margins.mass_ratio
    end = f"critical mass ratio {critical.value:.3g}" if critical else "no critical mass ratio"
    method = f"{plan.section['compensation.method']} at mass ratio {plan.mass_ratio:g}"
    title = f"preflight: {method} is {found.verdict}, {end}"
    figure.suptitle(title, fontsize=12, color=TEXT, x=0.01, ha="left")
    return figure


def _draw(axes: Axes, area: StabilityMap, scale: float, verdict: str) -> QuadContourSet:
    x, y = area.mass_ratios, scale * area.others
    # interpolated on a scale on which it is nearly straight across the critical line
    bent, levels = np.arcsinh(area.growth), np.arcsinh(_LEVELS)
    filled = axes.contourf(x, y, bent, levels=levels, colors=_COLOURS, extend="both")
    if bent.min() < 0 < bent.max():
        axes.contour(x, y, bent, levels=[0.0], colors=TEXT, linewidths=1.8)
    planned = area.planned[0], scale * area.planned[1]
    axes.plot(
        *planned, "o", ms=9, mfc=_PLAN[verdict], mec="white", mew=1.5, clip_on=False, zorder=5
    )
    axes.annotate("planned", planned, (9, 7), textcoords="offset points", fontsize=9, color=TEXT)
    axes.set_xlabel("mass ratio $\\alpha$", color=TEXT)
    axes.tick_params(colors=TEXT, labelsize=9)
    axes.spines[["top", "right"]].set_visible(False)
    return filled
