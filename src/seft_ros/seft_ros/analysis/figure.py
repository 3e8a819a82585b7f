"""A figure of a test: what was measured against the exact response."""

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from seft_msgs_py.wire.topics import RIG_STATE
from seft_plant_sim.reference.whole_structure import ReferenceResponse

from seft_ros.analysis.estimates import shown_unit
from seft_ros.analysis.metrics import nrmse
from seft_ros.analysis.reference import COMPARED, quantity
from seft_ros.analysis.shown import UNITS
from seft_ros.analysis.title import title_of
from seft_ros.drawing.style import FIRST, MARK, REFERENCE, SECOND, TEXT, legend_below, tidy
from seft_ros.drawing.thinning import thinned
from seft_ros.recording.record import Estimates, Record

MOST_AXES = 3
_HEIGHT, _LOW = 2.4, 1.3  # inches of a panel


def test_figure(record: Record, reference: ReferenceResponse | None) -> Figure:
    """Draw displacement, force and acceleration over time, one column for each axis.

    Below them stands what the compensation identified on line, if anything.

    Parameters
    ----------
    record : Record
        The test; of more than `MOST_AXES` axes the first are drawn.
    reference : ReferenceResponse or None
        Exact response by step, as `seft_ros.analysis.reference.reference_of` gives it.
    """
    axes = record.experiment.axes[:MOST_AXES]
    width = 9.5 if len(axes) == 1 else 5.5 * len(axes)
    estimates = record.estimates
    heights = [_HEIGHT] * len(UNITS) + [_LOW] * (len(estimates.names) if estimates else 0)
    figure = Figure(figsize=(width, sum(heights)), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(
        len(heights),
        len(axes),
        sharex=True,
        sharey="row",
        squeeze=False,
        height_ratios=heights,
    )
    for row, name in enumerate(UNITS):
        for column in range(len(axes)):
            _draw(panels[row, column], record, reference, name, column)
        unit = UNITS[name][0]
        panels[row, 0].set_ylabel(f"{name} / {unit}", color=TEXT)
    if estimates is not None:
        _draw_estimates(panels[len(UNITS) :], record, estimates)
    for column, axis in enumerate(axes):
        if len(record.experiment.axes) > 1:
            text = f"axis {axis}"
            panels[0, column].set_title(text, loc="left", fontsize=11, color=TEXT, parse_math=False)
        panels[-1, column].set_xlabel("time / s", color=TEXT)
    figure.align_ylabels()
    handles, labels = panels[0, 0].get_legend_handles_labels()
    legend_below(figure, dict(zip(labels, handles, strict=True)), len(labels))
    figure.suptitle(_title(record), fontsize=11, color=TEXT, parse_math=False)
    return figure


def _draw(
    panel: Axes, record: Record, reference: ReferenceResponse | None, name: str, column: int
) -> None:
    states, dt = record.series[RIG_STATE.name], record.experiment.timebase.dt
    scale = UNITS[name][1]
    row = dict(COMPARED)[name]
    y = states.values[:, row, column]
    if reference is not None:
        exact = quantity(reference, name)[:, column]
        at = thinned(exact)
        panel.plot(at * dt, exact[at] * scale, color=REFERENCE, lw=2.2, label="exact response")
        error = nrmse(y, exact[states.steps])
        text = f"NRMSE {error * 100:.3g} %" if np.isfinite(error) else "NRMSE undefined"
        panel.set_title(text, loc="right", fontsize=9, color=TEXT)
    at = thinned(y)
    panel.plot(states.steps[at] * dt, y[at] * scale, color=FIRST, lw=0.9, label="test")
    _finish(panel, record)


def _draw_estimates(panels: npt.NDArray[np.object_], record: Record, estimates: Estimates) -> None:
    time = estimates.steps * record.experiment.timebase.dt
    for row, name in enumerate(estimates.names):
        unit, scale = shown_unit(name)
        for column, panel in enumerate(panels[row]):
            panel.plot(time, estimates.values[:, row, column] * scale, color=SECOND, lw=1.2)
            _finish(panel, record)
        label = f"{name} / {unit}" if unit else name
        panels[row, 0].set_ylabel(label, color=TEXT, parse_math=False)


def _finish(panel: Axes, record: Record) -> None:
    if record.trip is not None:
        panel.axvline(record.trip.time_s, color=MARK, lw=1.2, ls="--", label="trip")
    panel.margins(x=0.01)
    tidy(panel)


def _title(record: Record) -> str:
    title = title_of(record)
    if record.trip is not None:
        title += f"\ntripped at {record.trip.time_s:.3f} s: {record.trip.reason}"
    return title
