"""A figure of an identification: flow, plant with its model, coherence, closed loop and delay."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PathCollection
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from seft_ros.drawing.style import FIRST, MARK, SECOND, TEXT, tidy
from seft_ros.identification.actuator_fit import ActuatorFit
from seft_ros.identification.identified import ClosedLoop, Identified, ValveResponse
from seft_ros.identification.spectral import Measurement
from seft_ros.loop_shaping.margins import FLATNESS_DB

MOST_AXES = 3
_SHADES = LinearSegmentedColormap.from_list("coherence", ["#dfe4e8", FIRST])
_SHOWN_DB = (-12.0, 6.0)
_COHERENT = 0.5  # below, a delay is noise
_NOTE: dict[str, Any] = {"fontsize": 8, "color": MARK, "va": "bottom"}
_SHOWN_S = 0.5  # of the flow
_OF_VALVE = ("flow / mm/s", "force per valve drive / N/V")
_OF_CLOSED_LOOP = ("tracking / dB", "delay / ms")


def identified_figure(identified: Identified, title: str) -> Figure:
    """Draw what was measured and fitted, one column for each of the first `MOST_AXES` axes."""
    axes = identified.axes[:MOST_AXES]
    valves, closed_loops = identified.valves, identified.closed_loops
    rows = [*_OF_VALVE * bool(valves), "coherence", *_OF_CLOSED_LOOP * bool(closed_loops)]
    width = 9.5 if len(axes) == 1 else 5.5 * len(axes)
    figure = Figure(figsize=(width, 2.6 * len(rows) + 0.5), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(rows), len(axes), squeeze=False)
    dots: PathCollection | None = None
    for column, axis in enumerate(axes):
        named = dict(zip(rows, panels[:, column], strict=True))
        for row, panel in named.items():
            tidy(panel)
            if row != _OF_VALVE[0]:
                panel.set_xscale("log")
                panel.set_xlim(*identified.band)
                panel.xaxis.set_major_formatter("{x:g}")
        if valves:
            _draw_flow(named[_OF_VALVE[0]], valves[column].actuator)
            dots = _draw_plant(named[_OF_VALVE[1]], valves[column])
            _draw_coherence(named["coherence"], valves[column].measured, FIRST, "valve to force")
        if closed_loops:
            closed = closed_loops[column]
            _draw_coherence(named["coherence"], closed.measured, SECOND, "reference to force")
            magnitude, delay = (named[row] for row in _OF_CLOSED_LOOP)
            _draw_tracking(magnitude, delay, closed)
        if len(identified.axes) > 1:
            panels[0, column].set_title(
                f"axis {axis}", loc="left", fontsize=11, color=TEXT, parse_math=False
            )
        panels[-1, column].set_xlabel("frequency / Hz", color=TEXT)
    for panel, label in zip(panels[:, 0], rows, strict=True):
        panel.set_ylabel(label, color=TEXT)
    if dots is not None:
        bar = figure.colorbar(dots, ax=list(panels[1]), aspect=15, pad=0.01)
        bar.set_label("coherence", color=TEXT)
        bar.outline.set_visible(False)
    figure.suptitle(title, fontsize=11, color=TEXT, parse_math=False)
    return figure


def _draw_flow(panel: Axes, actuator: ActuatorFit) -> None:
    """Draw the flow about its peak."""
    half = round(_SHOWN_S / 2 / actuator.dt)
    middle = max(int(np.abs(actuator.modelled).argmax()), half)
    shown = slice(middle - half, middle + half)
    time = actuator.dt * np.arange(len(actuator.modelled))[shown]
    panel.plot(time, 1e3 * actuator.measured[shown], color=FIRST, lw=1.4, label="measured")
    text = f"of the commands: explains {100 * actuator.explained:.3g} %, {actuator.verdict}"
    panel.plot(time, 1e3 * actuator.modelled[shown], color=MARK, lw=0.9, ls="--", label=text)
    panel.set_xlabel("time / s", color=TEXT)
    _legend(panel)


def _draw_plant(panel: Axes, valve: ValveResponse) -> PathCollection:
    measured, loop = valve.measured, valve.loop
    places = measured.frequencies_hz, np.abs(measured.response)
    look: dict[str, Any] = {"cmap": _SHADES, "vmin": 0.0, "vmax": 1.0, "s": 7, "lw": 0}
    dots = panel.scatter(*places, c=measured.coherence, label="measured", **look)
    shown = loop.frequencies_hz >= measured.frequencies_hz[0]
    f = loop.frequencies_hz[shown]
    text = f"actuator and specimen, {100 * valve.error:.2g} % off"
    panel.plot(f, np.abs(loop.sampled.plant[shown]), color=MARK, lw=1.1, label=text)
    panel.set_yscale("log")
    for root, name in ((loop.plant.antiresonance(), "zero"), (loop.plant.oil_column(), "oil")):
        if root and f[0] <= root.hz <= measured.frequencies_hz[-1]:
            panel.axvline(root.hz, color=MARK, lw=0.8, ls="--")
            percent = 100 * (root.damping or 0)
            _note(panel, root.hz, f"{name} {root.hz:.4g} Hz\ndamping {percent:.2g} %")
    _legend(panel)
    return dots


def _draw_coherence(panel: Axes, measured: Measurement, colour: str, label: str) -> None:
    panel.plot(measured.frequencies_hz, measured.coherence, color=colour, lw=0.8, label=label)
    panel.set_ylim(0.0, 1.05)
    _legend(panel)


def _draw_tracking(panel: Axes, below: Axes, closed: ClosedLoop) -> None:
    measured, tracking = closed.measured, closed.tracking
    f = measured.frequencies_hz
    fitted = closed.fit.model.response(f)
    panel.axhspan(-FLATNESS_DB, FLATNESS_DB, color=SECOND, alpha=0.12, lw=0)
    panel.plot(f, 20 * np.log10(np.abs(measured.response)), color=SECOND, lw=1.0, label="measured")
    panel.plot(f, 20 * np.log10(np.abs(fitted)), color=MARK, lw=0.9, ls="--", label="low-order fit")
    panel.set_ylim(*_SHOWN_DB)
    _legend(panel)
    flat = tracking.flat_to_hz
    if flat:
        panel.axvline(flat, color=MARK, lw=0.8, ls="--")
        _note(panel, flat, f"±{FLATNESS_DB:g} dB to {flat:.3g} Hz", 0.85)
    delays = np.where(measured.coherence < _COHERENT, np.nan, 1e3 * tracking.delay_by_frequency)
    below.plot(f, delays, color=SECOND, lw=1.0)
    if tracking.delay_s is not None:
        delay = 1e3 * tracking.delay_s
        below.axhline(delay, color=MARK, lw=0.8, ls="--")
        below.annotate(
            f"best-fit delay {delay:.3g} ms", (0.01, delay), (0, 3),
            xycoords=("axes fraction", "data"), textcoords="offset points", **_NOTE,
        )  # fmt: skip
        below.set_ylim(0.0, 2.0 * delay)


def _legend(panel: Axes) -> None:
    panel.legend(loc="lower left", frameon=False, fontsize=9)


def _note(panel: Axes, hz: float, text: str, height: float = 0.03) -> None:
    """Write beside a frequency, on the side where there is room."""
    low, high = panel.get_xlim()
    left = hz**2 > low * high and hz > high / 4
    panel.annotate(
        text, (hz, height), (-4 if left else 4, 0), xycoords=("data", "axes fraction"),
        textcoords="offset points", ha="right" if left else "left", **_NOTE,
    )  # fmt: skip
