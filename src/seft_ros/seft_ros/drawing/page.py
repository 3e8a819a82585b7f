"""A page of text, tables and zoomable figures in one HTML file; its look is in the templates."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from bokeh import models
from bokeh.document import Document
from bokeh.embed import components
from bokeh.plotting import figure
from bokeh.resources import Resources
from bokeh.themes import Theme
from jinja2 import Environment, PackageLoader, StrictUndefined
from seft_msgs_py.errors import InputError

from seft_ros.drawing import style

SUFFIX = ".html"
_HEIGHT = 260  # pixels
_TOOLS = "box_zoom,xwheel_zoom,pan,reset,save"
_FAINT = "#aab1b8"
_LOOK = {
    "Axis": {"axis_label_text_font_style": "normal"}
    | dict.fromkeys(("axis_label_text_color", "major_label_text_color"), style.TEXT)
    | dict.fromkeys(("axis_line_color", "major_tick_line_color", "minor_tick_line_color"), _FAINT),
    "Grid": {"grid_line_color": style.GRID},
    "Legend": {"orientation": "horizontal", "border_line_color": None, "background_fill_alpha": 0.0}
    | {"label_text_color": style.TEXT, "label_text_font_size": "13px", "spacing": 14}
    | {"padding": 0, "margin": 0, "click_policy": "hide"},
    "Plot": {"outline_line_color": None, "min_border_right": 12},
    "Toolbar": {"logo": None, "autohide": True},
}
_LOG_TICKS = [digit * 10.0**power for power in range(-6, 7) for digit in (1, 2, 5)]


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    text: str


@dataclass(frozen=True)
class VerdictBox:
    """The verdict in one line, in the colour of its mark; below it, the findings behind it."""

    mark: style.Mark
    text: str
    findings: Sequence[style.Cell] = ()


@dataclass(frozen=True)
class Plot:
    """A figure of `seft_ros.drawing.page`, and in one or two sentences what to look for.

    A wide one has the page's whole width; otherwise two are side by side where there is room.
    """

    figure: models.Model
    caption: str = ""
    wide: bool = False


@dataclass(frozen=True)
class Grid:
    """Plots side by side, 2 to 4 in a row, where there is room; otherwise one below the other."""

    plots: Sequence[Plot]
    columns: int = 3


Block = Text | VerdictBox | style.TextTable | Plot | Grid


@dataclass(frozen=True)
class PageSection:
    """A heading and the blocks under it."""

    title: str
    blocks: Sequence[Block]


def write_page(path: Path, title: str, subtitle: str, sections: Sequence[PageSection]) -> None:
    """Write a page; figures, the library that draws them, and styles are inside the file.

    An InputError says why it can't be written.
    """
    blocks = [block for section in sections for block in section.blocks]
    grids = [plot for block in blocks if isinstance(block, Grid) for plot in block.plots]
    plots = [*(block for block in blocks if isinstance(block, Plot)), *grids]
    figures = {plot.figure.id: plot.figure for plot in plots}
    document = Document(theme=Theme(json={"attrs": _LOOK}))
    with document.models.freeze():  # one look at all models, not one for each figure
        for one in figures.values():
            for legend in one.legend:
                one.center.remove(legend)
                one.add_layout(legend, "above")
            document.add_root(one)
    script, places = components(figures) if figures else ("", {})
    library = Resources(mode="inline", components=["bokeh"]).render_js() if figures else ""
    environment = Environment(
        loader=PackageLoader("seft_ros.drawing", "templates"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
        finalize=_tied,
    )
    text = environment.get_template("page.html").render(
        title=title,
        subtitle=subtitle,
        sections=sections,
        anchors=[re.sub(r"[^a-z0-9]+", "-", s.title.lower()).strip("-") for s in sections],
        library=library,
        script=script,
        places=places,
        kind=lambda block: type(block).__name__,
    )
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: the page can't be written ({error.strerror})") from None


def _tied(text: Any) -> Any:
    """Keep numbers and their units in one line; what is HTML already is left."""
    return re.sub(r"(?<=[\d±]) (?=\S)", "\u00a0", text) if type(text) is str else text


def check_page(path: Path) -> Path:
    """Complete the name of a page's file, before the work is done that it shows.

    An InputError says that there is no such folder, or that the suffix is of another kind of file.
    """
    return style.check_file(path, "pages", SUFFIX, (SUFFIX, ".htm"))


def plot(
    x_label: str,
    y_label: str,
    *,
    x_range: models.Range1d | None = None,
    log_x: bool = False,
    log_y: bool = False,
    height: int = _HEIGHT,
) -> figure:
    """Make an empty figure, as wide as the page gives it room and so many pixels high.

    Labels have units: ``time / s``. Figures with the same ``x_range`` zoom together.
    """
    found = figure(
        height=height,
        sizing_mode="stretch_width",
        tools=_TOOLS,
        active_drag="box_zoom",
        x_axis_label=x_label,
        y_axis_label=y_label,
        x_axis_type="log" if log_x else "linear",
        y_axis_type="log" if log_y else "linear",
        x_range=x_range or models.DataRange1d(),
    )
    if log_x:
        found.xaxis.formatter = models.NumeralTickFormatter(format="0.[000]")
        found.xaxis.ticker = models.FixedTicker(ticks=_LOG_TICKS)
        found.xaxis.major_label_policy = models.NoOverlap()
    return found


def line(
    panel: figure,
    x: style.AnyFloats,
    y: style.AnyFloats,
    label: str = "",
    *,
    color: str = style.FIRST_COLOUR,
    width: float = 1.3,
    dash: str = "solid",
    loop: bool = False,
) -> None:
    """Draw a line, thinned to `MAX_POINTS`; values that are not finite are a gap.

    The label is in the legend and under the pointer; empty: in neither. A line is over increasing
    x; a ``loop``, such as a hysteresis, is one of which neither coordinate increases.
    """
    at = style.thinned(y)
    if loop:
        at = np.arange(0, len(x), max(1, -(-len(x) // (2 * style.MAX_POINTS))))
    renderer = panel.line(
        np.asarray(x)[at].astype(np.float32),
        np.where(np.isfinite(y[at]), y[at], np.nan).astype(np.float32),
        color=color,
        line_width=width,
        line_dash=dash,
        **({"legend_label": label} if label else {}),
    )
    if label and not loop:
        _hover(panel, renderer, (label, "@y{0.0000a}"), (str(panel.xaxis.axis_label), "@x{0.000}"))


def against(
    panel: figure,
    exact: tuple[style.AnyFloats, style.AnyFloats] | None,
    test: tuple[style.AnyFloats, style.AnyFloats],
    labels: tuple[str, str] = ("reference response", "test"),
    *,
    loop: bool = False,
) -> None:
    """Draw a test, (x, y), over its reference, if there is one."""
    if exact is not None:
        line(panel, *exact, labels[0], color=style.REFERENCE, width=3.0, loop=loop)
    line(panel, *test, labels[1], width=0.9 if loop else 1.3, loop=loop)


def bars(panel: figure, edges: style.AnyFloats, counts: style.AnyFloats) -> None:
    """Draw a histogram: counts, shape (B,), between edges, shape (B + 1,)."""
    low = 0.5 if "Log" in type(panel.y_scale).__name__ else 0.0
    sides = {"left": edges[:-1], "right": edges[1:], "bottom": low, "top": counts}
    renderer = panel.quad(**sides, color=style.FIRST_COLOUR, line_color="white")
    _hover(panel, renderer, ("from", "@left{0.000}"), ("to", "@right{0.000}"), ("count", "@top{0}"))


def band(panel: figure, low: float, high: float, color: str = style.MARK) -> None:
    """Shade a range of x."""
    shade = {"fill_color": color, "fill_alpha": 0.1, "line_color": None, "level": "underlay"}
    panel.add_layout(models.BoxAnnotation(left=low, right=high, **shade))


def mark(panel: figure, x: float) -> None:
    """Draw a vertical dashed line."""
    span = models.Span(location=x, dimension="height", line_color=style.MARK, line_dash="dashed")
    panel.add_layout(span)


def level(panel: figure, y: float) -> None:
    """Draw a horizontal dashed line."""
    panel.add_layout(
        models.Span(location=y, dimension="width", line_color=_FAINT, line_dash="dashed")
    )


def time_range(times: Sequence[float] | style.AnyFloats) -> models.Range1d:
    """Make a range that figures over the same time share."""
    low, high = (float(times[0]), float(times[-1])) if len(times) else (0.0, 1.0)
    high = high if high > low else low + 1.0
    return models.Range1d(low, high, bounds=(low, high))


def _hover(panel: figure, renderer: models.Model, *tips: tuple[str, str]) -> None:
    panel.add_tools(models.HoverTool(renderers=[renderer], tooltips=list(tips), visible=False))
