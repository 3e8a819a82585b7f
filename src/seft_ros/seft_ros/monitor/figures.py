"""The figures of the page, still empty; its script puts the lines into them."""

from typing import Any

from bokeh.embed import json_item
from bokeh.models import ColumnDataSource, Range1d
from bokeh.plotting import figure

from seft_ros.drawing.style import FIRST, MARK, REFERENCE, SECOND
from seft_ros.page.plots import plot

HEIGHT = 230  # pixels
LABELS = {
    "displacement": "displacement / mm",
    "acceleration": "acceleration / (m/s²)",
    "force": "force / kN",
    "timing": "time / ms",
}


def figures() -> dict[str, Any]:
    """Make all figures, by name, as ``Bokeh.embed.embed_item`` takes them.

    Their data sources are called ``measured`` and ``reference`` (for ``timing`` ``answer``,
    ``median``, ``largest``, ``missed``), with columns x in s and y in the unit of the axis.
    """
    found = {name: _empty(label) for name, label in LABELS.items()}
    for name, panel in found.items():
        if name == "timing":
            _line(panel, "answer", SECOND, 1.0)
            _line(panel, "largest", REFERENCE, 1.5, mode="before")
            _line(panel, "median", FIRST, 2.0, mode="before")
            source = ColumnDataSource({"x": [], "y": []}, name="missed")
            panel.scatter("x", "y", source=source, color=MARK, marker="inverted_triangle", size=9)
        else:
            _line(panel, "reference", REFERENCE, 2.4)
            _line(panel, "measured", FIRST, 1.2)
    return {name: json_item(panel) for name, panel in found.items()}


def _empty(label: str) -> figure:
    panel = plot("time / s", label, x_range=Range1d(0.0, 20.0), height=HEIGHT)
    panel.y_range = Range1d(-1.0, 1.0)
    panel.output_backend = "canvas"
    panel.background_fill_alpha = panel.border_fill_alpha = 0.0  # the page's own, dark or light
    return panel


def _line(panel: figure, name: str, color: str, width: float, mode: str = "") -> None:
    source = ColumnDataSource({"x": [], "y": []}, name=name)
    draw = panel.step if mode else panel.line
    extra = {"mode": mode} if mode else {}
    draw("x", "y", source=source, color=color, line_width=width, name=name, **extra)
