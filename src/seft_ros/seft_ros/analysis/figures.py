"""Figures of tests: one against its reference response, or two on one another."""

from collections.abc import Iterable, Sequence
from textwrap import wrap
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from seft_msgs_py.arrays import Ints
from seft_msgs_py.wire.outcome import BY_OPERATOR
from seft_plant_sim.whole_structure import ReferenceResponse

from seft_ros.analysis.metrics import common_steps, nrmse
from seft_ros.analysis.result_text import title_of
from seft_ros.analysis.summary import AFTER, COMPARED, assessed_part, strong_part
from seft_ros.bags.recording import Recording
from seft_ros.drawing import style
from seft_ros.drawing.style import AnyFloats, axis_label, percent, thinned, tidy
from seft_ros.reference_force.reference_force_parameters import OF_MODEL

_MAX_AXES = 3
_PER_INCH = 11  # characters of a title
_MOST_BRIDGED = 5  # steps


def test_figure(recording: Recording, reference: ReferenceResponse | None) -> Figure:
    """Draw displacement, force and acceleration of a test over time, against the reference.

    The time is that of the ground motion's `strong_part`.
    One column for each axis, of more than `_MAX_AXES` the first. Below are the parameters that
    the compensation identified on line, if any.
    """
    axes, estimates = recording.experiment.axes[:_MAX_AXES], recording.estimates
    states, dt = recording.states, recording.experiment.timebase.dt
    assessed = len(assessed_part(recording)[0].states.steps)
    names = estimates.names if estimates else ()
    estimated = [name for name in names if not name.startswith(OF_MODEL)]
    heights = [2.4] * len(style.RESPONSES) + [1.3] * len(estimated)  # inches
    width = 9.5 if len(axes) == 1 else 5.5 * len(axes)
    figure, panels = _panels(width, heights, len(axes))
    for row, name in enumerate(style.RESPONSES):
        _, scale = style.DISPLAY_UNITS[name]
        for column, panel in enumerate(panels[row]):
            y = states.values[:, COMPARED[name], column]
            if reference is not None:
                exact = getattr(reference, name)[:, column]
                at, look = thinned(exact), {"color": style.REFERENCE, "lw": 2.2}
                panel.plot(at * dt, exact[at] * scale, label="reference response", **look)
                error = nrmse(y[:assessed], exact[states.steps[:assessed]])
                text = f"NRMSE {percent(error)}" if np.isfinite(error) else "NRMSE undefined"
                panel.set_title(text, loc="right", fontsize=9, color=style.TEXT)
            at, look = thinned(y), {"color": style.FIRST_COLOUR, "lw": 0.9}
            panel.plot(states.steps[at] * dt, y[at] * scale, label="test", **look)
    if estimates is not None:
        for row, name in zip(panels[len(style.RESPONSES) :], estimated, strict=True):
            _, scale = style.DISPLAY_UNITS.get(name, ("", 1.0))
            for column, panel in enumerate(row):
                y = estimates.values[:, names.index(name), column]
                panel.plot(estimates.steps * dt, y * scale, color=style.SECOND, lw=1.2)
    for panel, name in zip(panels[:, 0], (*style.RESPONSES, *estimated), strict=True):
        label = axis_label(name)
        if name in estimated:  # their panels are low
            label = label.replace(" / ", "\n/ ")
        panel.set_ylabel(label, color=style.TEXT, parse_math=False)
    last, mark = recording.last_step, "stop" if recording.stopped else "trip"
    _frame(panels.flat, None if last is None else last * dt, mark)
    start, end = strong_part(recording)
    panels[0, 0].set_xlim(start, end)  # all panels share their time
    for column, axis in enumerate(axes):
        if len(recording.experiment.axes) > 1:
            look = {"loc": "left", "fontsize": 11, "color": style.TEXT, "parse_math": False}
            panels[0, column].set_title(f"axis {axis}", **look)
        panels[-1, column].set_xlabel("time / s", color=style.TEXT)
    title = title_of(recording)
    if (duration := len(states.steps) * dt) > end - start + AFTER:
        title += f"\nstrong part, of {duration:.3g} s"
    if recording.trip is not None:
        trip = f"tripped at {recording.trip.time_s:.3f} s: {recording.trip.reason}"
        title = "\n".join([title, *wrap(trip, round(_PER_INCH * width))])
    elif recording.stopped:
        title += f"\n{BY_OPERATOR}"
    style.finish(figure, panels[:1, 0], title)
    return figure


def comparison_figure(
    a: Recording, b: Recording, comparison: dict[str, Any], names: Sequence[str]
) -> Figure:
    """Draw displacement, force and acceleration of two tests on their first axis.

    Below each is the difference of the second from the first; a dashed line marks the first
    difference on any topic. ``comparison`` is what
    `seft_ros.analysis.comparison.compare_recordings` gives.
    """
    figure, grid = _panels(9.5, [1.9, 1.1] * len(style.RESPONSES), margin=0.6)
    panels, dt = grid[:, 0], a.experiment.timebase.dt
    one, other = (recording.states for recording in (a, b))
    steps, in_a, in_b = common_steps(one.steps, other.steps)
    looks = ((one, names[0], style.REFERENCE, 2.4), (other, names[1], style.FIRST_COLOUR, 0.9))
    for name, overlay, below in zip(style.RESPONSES, panels[::2], panels[1::2], strict=True):
        row, (unit, scale) = COMPARED[name], style.DISPLAY_UNITS[name]
        for series, label, color, width in looks:
            curve = _broken(series.steps * dt, series.values[:, row, 0] * scale, series.steps)
            overlay.plot(*curve, color=color, lw=width, label=label)
        apart = (other.values[in_b] - one.values[in_a])[:, row, 0] * scale
        below.plot(*_broken(steps * dt, apart, steps), color=style.FIRST_COLOUR, lw=0.9)
        below.ticklabel_format(axis="y", style="sci", scilimits=(-3, 4))
        below.yaxis.offsetText.set(fontsize=8, color=style.TEXT)
        overlay.set_ylabel(axis_label(name), color=style.TEXT)
        below.set_ylabel(f"difference\n/ {unit}", color=style.TEXT)
    first = comparison["first_difference"]
    time = None if first is None else first["step"] * dt
    label = "" if first is None else f"first difference: {first['topic']}, {time:g} s"
    _frame(panels, time, label)
    panels[-1].set_xlabel("time / s", color=style.TEXT)
    axis = a.experiment.axes[0]
    style.finish(figure, panels[:1], f"axis {axis}: difference from {names[0]}")
    return figure


def _frame(panels: Iterable[Axes], marked: float | None = None, label: str = "") -> None:
    """Finish panels, with a dashed line at a time where there is one to be marked."""
    for panel in panels:
        if marked is not None:
            panel.axvline(marked, color=style.MARK, lw=1.2, ls="--", label=label)
        panel.margins(x=0.01)
        tidy(panel)


def _broken(time: AnyFloats, values: AnyFloats, steps: Ints) -> tuple[AnyFloats, AnyFloats]:
    """Break a line where many steps are missing; where few are it would vanish."""
    gaps = np.flatnonzero(np.diff(steps) > _MOST_BRIDGED) + 1
    return np.insert(time, gaps, np.nan), np.insert(values, gaps, np.nan)


def _panels(
    width: float, heights: Sequence[float], columns: int = 1, margin: float = 0.0
) -> tuple[Figure, npt.NDArray[np.object_]]:
    """Make a figure of panels that share their time, row by row; sizes in inches."""
    figure = style.new_figure(width, sum(heights) + margin)
    options: dict[str, Any] = {"squeeze": False, "height_ratios": heights}
    return figure, figure.subplots(len(heights), columns, sharex=True, sharey="row", **options)
