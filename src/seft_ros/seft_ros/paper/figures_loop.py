"""Figures 3 and 4: the force loop's responses, measured and of the fitted model."""

import numpy as np
import numpy.typing as npt
from bokeh.models import Range1d
from bokeh.plotting import figure

from seft_ros.drawing.style import FIRST, OTHERS
from seft_ros.loop_shaping.margins import BAND_HZ
from seft_ros.page.content import Grid, Plot
from seft_ros.page.plots import band, level, line, mark, plot
from seft_ros.paper.findings import Findings
from seft_ros.paper.force_loop import force_loop

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

MEASURED, MODEL = "experiment", "analysis"
_RANGE_HZ = (0.5, 200.0)
_MODEL_COLOR = OTHERS[2]
_HEIGHT = 250


def open_loop_figure(found: Findings) -> Grid:
    """Draw Figure 3: plant, controller and loop; magnitudes above, phases below."""
    loop = force_loop(found.identified, found.experiment.timebase.dt)
    shared = Range1d(*_RANGE_HZ)
    f, own = loop.plant.frequencies_hz, loop.model.frequencies_hz
    model = loop.model.sampled
    zero, pole = loop.roots_hz()
    columns = [
        ("(a) valve to force, N/V", [(f, loop.plant.response, MEASURED), (own, model.plant, MODEL)],
         f"Zero at {zero:.3g} Hz, the specimen's natural frequency; pole at {pole:.3g} Hz, the oil "
         "column."),
        ("(b) controller, V/N", [(own, model.controller, "as it runs")],
         "Its poles stand on the plant's zero."),
        ("(c) loop", [(f, loop.measured_loop(), MEASURED), (own, model.loop, MODEL)],
         "High, then low, without a kink; it crosses 0 dB at the mark."),
    ]  # fmt: skip
    magnitudes, phases = [], []
    for title, curves, caption in columns:
        panel = _panel(f"{title}, dB", shared)
        panels = (panel, _panel("phase / degrees", shared))
        for hz, response, label in curves:
            _draw(panels, hz, response, label, draw_both=len(curves) > 1)
        if title.startswith("(a)"):
            mark(panel, zero)
            mark(panel, pole)
        if title.startswith("(c)"):
            level(panel, 0.0)
            if loop.model.margins.crossover_hz is not None:
                mark(panel, loop.model.margins.crossover_hz)
        magnitudes.append(Plot(panel, caption))
        phases.append(Plot(panels[1]))
    return Grid([*magnitudes, *phases])


def closed_loop_figure(found: Findings) -> Grid:
    """Draw Figure 4: reference force to measured force."""
    loop = force_loop(found.identified, found.experiment.timebase.dt)
    shared = Range1d(0.0, 60.0, bounds=(0.0, 60.0))
    panels = (
        plot("frequency / Hz", "(a) magnitude, dB", x_range=shared),
        plot("frequency / Hz", "(b) phase / degrees", x_range=shared),
    )
    curves = (
        (loop.tracking.frequencies_hz, loop.tracking.response, MEASURED),
        (loop.model.frequencies_hz, loop.model.sampled.tracking, MODEL),
    )
    for hz, response, label in curves:
        shown = (hz >= _RANGE_HZ[0]) & (hz <= 60.0)
        _draw(panels, hz[shown], response[shown], label)
    level(panels[0], 0.0)
    for panel in panels:
        band(panel, 0.0, BAND_HZ, color=FIRST)
    tracking = found.identified.closed_loops[0].tracking
    if tracking.dip_hz is not None:
        mark(panels[0], tracking.dip_hz)
    delay = 1e3 * found.own_delay
    return Grid(
        [
            Plot(panels[0], f"Flat up to {BAND_HZ:g} Hz (shaded), with a small dip at the mark."),
            Plot(panels[1], f"Nearly a straight line: a delay, here of {delay:.1f} ms."),
        ],
        columns=2,
    )


def _panel(label: str, shared: Range1d) -> figure:
    return plot("frequency / Hz", label, x_range=shared, log_x=True, height=_HEIGHT)


def _draw(
    panels: tuple[figure, figure],
    hz: Floats,
    response: Complexes,
    label: str,
    *,
    draw_both: bool = True,
) -> None:
    """Draw magnitude and phase, the experiment below the analysis."""
    shown = (hz >= _RANGE_HZ[0]) & (hz <= _RANGE_HZ[1])
    hz, response = hz[shown], response[shown]
    measured = label == MEASURED or not draw_both
    color, dash = (FIRST, "solid") if measured else (_MODEL_COLOR, "6 4")
    line(panels[0], hz, 20 * np.log10(np.abs(response)), label, color=color, dash=dash)
    line(panels[1], hz, np.degrees(np.unwrap(np.angle(response))), label, color=color, dash=dash)
