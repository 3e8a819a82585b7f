"""A figure of several tests on one another, and the difference of each from the first."""

from collections.abc import Sequence
from itertools import cycle
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import RIG_STATE

from seft_ros.analysis.alignment import Alignment
from seft_ros.analysis.reference import COMPARED
from seft_ros.analysis.shown import UNITS
from seft_ros.drawing.style import MARK, OTHERS, REFERENCE, TEXT, legend_below, tidy
from seft_ros.recording.record import Record

Floats = npt.NDArray[np.floating[Any]]

_HEIGHT, _LOW = 1.9, 1.1  # inches of a panel
_MOST_BRIDGED = 5  # steps


def comparison_figure(
    records: Sequence[Record], comparisons: Sequence[dict[str, Any]], names: Sequence[str]
) -> Figure:
    """Draw displacement, force and acceleration of the first axis that all tests have.

    Below each stands how the further tests differ from the first. A dashed line marks the first
    difference on any topic, bars at the foot mark where a test lacks states of the rig.

    Parameters
    ----------
    records : sequence of Record
        Two or more.
    comparisons : sequence of dict
        Of each further record with the first, as `seft_ros.analysis.compare.compare` gives it.
    names : sequence of str
        What the records are called.

    Raises
    ------
    InputError
        If there is no axis that all have.
    """
    axis = _common_axis(records)
    heights = [_HEIGHT, _LOW] * len(UNITS)
    figure = Figure(figsize=(9.5, sum(heights) + 0.6), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)
    for index, (name, (unit, _)) in enumerate(UNITS.items()):
        overlay, difference = panels[2 * index : 2 * index + 2]
        _draw_overlay(overlay, records, names, name, axis)
        _draw_differences(difference, records, name, axis)
        overlay.set_ylabel(f"{name} / {unit}", color=TEXT)
        difference.set_ylabel(f"difference\n/ {unit}", color=TEXT)
    for panel in panels:
        _mark_first_difference(panel, records[0], comparisons)
        panel.margins(x=0.01)
        tidy(panel)
    panels[-1].set_xlabel("time / s", color=TEXT)
    figure.align_ylabels()
    entries = {
        label: handle
        for panel in panels[:2]
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True)
    }
    legend_below(figure, entries, 4)
    title = f"axis {axis}: difference from {names[0]}"
    figure.suptitle(title, fontsize=11, color=TEXT, parse_math=False)
    return figure


def _common_axis(records: Sequence[Record]) -> str:
    for axis in records[0].experiment.axes:
        if all(axis in record.experiment.axes for record in records):
            return axis
    raise InputError("no axis is in all of these tests, so there is no figure of them")


def _draw_overlay(
    panel: Axes, records: Sequence[Record], names: Sequence[str], name: str, axis: str
) -> None:
    row, scale = dict(COMPARED)[name], UNITS[name][1]
    colours = cycle(OTHERS)
    for index, record in enumerate(records):
        states, column = record.series[RIG_STATE.name], record.experiment.axes.index(axis)
        time = states.steps * record.experiment.timebase.dt
        look: dict[str, Any] = (
            {"color": next(colours), "lw": 0.9} if index else {"color": REFERENCE, "lw": 2.4}
        )
        panel.plot(*_broken(time, states.values[:, row, column] * scale, states.steps), **look)
        panel.plot([], [], label=names[index], **look)


def _draw_differences(panel: Axes, records: Sequence[Record], name: str, axis: str) -> None:
    row, scale = dict(COMPARED)[name], UNITS[name][1]
    colours = cycle(OTHERS)
    a, differ, common = records[0], False, False
    for b in records[1:]:
        alignment = Alignment.of(a, b)
        column = alignment.axes.index(axis)
        dt = a.experiment.timebase.dt * alignment.every_a
        one = alignment.on_grid_a(a.series[RIG_STATE.name])
        other = alignment.on_grid_b(b.series[RIG_STATE.name])
        steps, in_a, in_b = np.intersect1d(one.steps, other.steps, return_indices=True)
        apart = other.values[in_b][:, row, column] - one.values[in_a][:, row, column]
        panel.plot(*_broken(steps * dt, apart * scale, steps), color=next(colours), lw=0.9)
        differ, common = differ or bool(np.any(apart != 0)), common or len(steps) > 0
        _mark_missing(panel, np.setxor1d(one.steps, other.steps), dt)
    if not differ:
        panel.set_ylim(-1, 1)
        panel.set_yticks([0])
        text = "no difference" if common else "no common samples"
        panel.text(0.01, 0.75, text, transform=panel.transAxes, fontsize=9, color=TEXT)
    else:
        panel.ticklabel_format(axis="y", style="sci", scilimits=(-3, 4))
        panel.yaxis.offsetText.set(fontsize=8, color=TEXT)


def _broken(time: Floats, values: Floats, steps: npt.NDArray[np.int64]) -> tuple[Floats, Floats]:
    """Break a line where many steps are missing; where few are it would vanish."""
    gaps = np.flatnonzero(np.diff(steps) > _MOST_BRIDGED) + 1
    return np.insert(time, gaps, np.nan), np.insert(values, gaps, np.nan)


def _mark_missing(panel: Axes, steps: npt.NDArray[np.int64], dt: float) -> None:
    if not len(steps):
        return
    ends = np.flatnonzero(np.diff(steps) != 1)
    starts, stops = steps[[0, *(ends + 1)]] * dt, steps[[*ends, -1]] * dt
    foot = panel.get_xaxis_transform()
    panel.hlines(np.full(len(starts), 0.05), starts, stops, transform=foot, color=MARK, lw=4)
    panel.plot(starts, np.full(len(starts), 0.05), "|", transform=foot, color=MARK, ms=7)
    panel.plot([], [], color=MARK, lw=4, label="samples missing")


def _mark_first_difference(
    panel: Axes, record: Record, comparisons: Sequence[dict[str, Any]]
) -> None:
    firsts = [c["first_difference"] for c in comparisons if c["first_difference"] is not None]
    if not firsts:
        return
    first = min(firsts, key=lambda first: first["step"])
    time = first["step"] * record.experiment.timebase.dt
    label = f"first difference: {first['topic']}, {time:g} s"
    panel.axvline(time, color=MARK, lw=1.2, ls="--", label=label)
