"""The figures of the page, still empty; its script puts the lines into them."""

from typing import Any

from bokeh.embed import json_item
from bokeh.models import ColumnDataSource, NumeralTickFormatter, Range1d
from bokeh.plotting import figure

from seft_ros.page.plots import plot

HEIGHT = 230  # pixels
LEFT = 64  # pixels for the numbers: all figures begin at the same place, and nothing jumps
LINES = {
    "displacement": ("displacement / mm", ("reference", "measured")),
    "acceleration": ("acceleration / (m/s²)", ("reference", "measured")),
    "force": ("force / kN", ("reference", "measured")),
    "spectrum": ("pseudo-acceleration / (m/s²)", ("natural", "reference", "measured")),
    "timing": ("time / ms", ("answer", "largest", "median", "period")),
    "missed": ("missed commands", ("missed",)),
}
"""Of each figure: the vertical axis, and its lines, the last on top."""
WIDTHS = {"natural": 1.0, "reference": 3.0, "answer": 1.0, "period": 1.0, "median": 2.0}
STEPPED = ("largest", "median", "missed")
"""What is told once a second, of the second before."""


def figures() -> dict[str, Any]:
    """Make all figures, by name, as ``Bokeh.embed.embed_item`` takes them.

    Each line has a data source of its name, with columns x in s and y in the unit of the axis.
    """
    return {name: json_item(_figure(name, *LINES[name])) for name in LINES}


def _figure(name: str, label: str, lines: tuple[str, ...]) -> figure:
    spectrum = name == "spectrum"
    panel = plot(
        "frequency / Hz" if spectrum else "time / s",
        label,
        x_range=Range1d(1.0, 50.0) if spectrum else Range1d(0.0, 20.0),
        height=HEIGHT,
        log_x=spectrum,
        log_y=name == "timing",
    )
    panel.y_range = Range1d(0.1, 10.0) if name == "timing" else Range1d(-1.0, 1.0)
    if name == "timing":
        panel.yaxis.formatter = NumeralTickFormatter(format="0.[000]")
    panel.background_fill_alpha = panel.border_fill_alpha = 0.0  # the page's own, dark or light
    panel.min_border_left = LEFT
    for axis in panel.axis:
        axis.ticker.desired_num_ticks = 5  # each number costs time whenever it is drawn
    for line in lines:
        source = ColumnDataSource({"x": [], "y": []}, name=line)
        draw = panel.step if line in STEPPED else panel.line
        mode = {"mode": "before"} if line in STEPPED else {}
        draw("x", "y", source=source, line_width=WIDTHS.get(line, 1.3), **mode)
    return panel
