"""The figure of an identified rig: what was measured, and the fits."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from seft_ros.design.plant import Plant
from seft_ros.drawing.style import FIRST_COLOUR, MARK, SECOND, TEXT, new_figure, tidy
from seft_ros.identification.actuator_fit import ActuatorFit
from seft_ros.identification.identified import ClosedLoop, Identified, ValveResponse
from seft_ros.identification.measured_test import Measurement
from seft_ros.identification.response_fits import FLATNESS_DB

_MAX_AXES = 3
_SHOWN_TRACKING_DB = (-12.0, 6.0)
_SHOWN_S = 0.5  # of the flow
_POINTS = 2000  # of a response
_NOTE: dict[str, Any] = {"fontsize": 8, "color": MARK, "va": "bottom"}
_LINE: dict[str, Any] = {"color": MARK, "lw": 0.8, "ls": "--"}
_HEADING: dict[str, Any] = {"fontsize": 11, "color": TEXT, "parse_math": False}
_OF_VALVE = ("flow / (mm/s)", "force per valve drive / (N/V)")
_TRACKING = "tracking / dB"


def identified_figure(identified: Identified, title: str) -> Figure:
    """Draw measurements and fits, one column for each of the first `_MAX_AXES` axes."""
    names, valves, closed = identified.axes[:_MAX_AXES], identified.valves, identified.closed_loops
    rows = [*_OF_VALVE * bool(valves), *[_TRACKING] * bool(closed), "coherence"]
    width = 9.5 if len(names) == 1 else 5.5 * len(names)
    figure = new_figure(width, 2.6 * len(rows) + 0.5)
    panels = figure.subplots(len(rows), len(names), squeeze=False)
    for column, axis in enumerate(names):
        panel = dict(zip(rows, panels[:, column], strict=True))
        coherence = panel["coherence"]
        for row, axes in panel.items():
            tidy(axes)
            if row != _OF_VALVE[0]:
                axes.set_xscale("log")
                axes.set_xlim(*identified.band)
                axes.xaxis.set_major_formatter("{x:g}")
        if valves:
            valve = valves[column]
            _draw_flow(panel[_OF_VALVE[0]], valve.actuator)
            _draw_plant(panel[_OF_VALVE[1]], valve)
            _draw_coherence(coherence, valve.measured, FIRST_COLOUR, "valve to force")
        if closed:
            _draw_tracking(panel[_TRACKING], closed[column])
            _draw_coherence(coherence, closed[column].measured, SECOND, "reference to force")
        coherence.set_ylim(0.0, 1.05)
        if len(identified.axes) > 1:
            panels[0, column].set_title(f"axis {axis}", loc="left", **_HEADING)
        panels[-1, column].set_xlabel("frequency / Hz", color=TEXT)
        for axes in panel.values():
            axes.legend(loc="lower left", frameon=False, fontsize=9)
    for axes, label in zip(panels[:, 0], rows, strict=True):
        axes.set_ylabel(label, color=TEXT)
    figure.suptitle(title, **_HEADING)
    return figure


def _draw_coherence(panel: Axes, measured: Measurement, colour: str, label: str) -> None:
    panel.plot(measured.frequencies_hz, measured.coherence, color=colour, lw=0.8, label=label)


def _draw_flow(panel: Axes, actuator: ActuatorFit) -> None:
    """Draw the flow about its peak."""
    half = round(_SHOWN_S / 2 / actuator.dt)
    middle = max(int(np.abs(actuator.modelled).argmax()), half)
    shown = slice(middle - half, middle + half)
    time = actuator.dt * np.arange(len(actuator.modelled))[shown]
    panel.plot(time, 1e3 * actuator.measured[shown], color=FIRST_COLOUR, lw=1.4, label="measured")
    text = f"of the commands: explains {100 * actuator.explained:.3g} %, {actuator.verdict}"
    panel.plot(time, 1e3 * actuator.modelled[shown], color=MARK, lw=0.9, ls="--", label=text)
    panel.set_xlabel("time / s", color=TEXT)


def _draw_plant(panel: Axes, valve: ValveResponse) -> None:
    measured, plant = valve.measured, valve.plant
    places = measured.frequencies_hz, np.abs(measured.response)
    panel.plot(*places, ".", color=FIRST_COLOUR, ms=3, label="measured")
    dt = valve.actuator.dt
    f = np.geomspace(measured.frequencies_hz[0], 0.499 / dt, _POINTS)
    text = f"actuator and specimen, error {100 * valve.error:.2g} %"
    panel.plot(f, np.abs(plant.sampled_response(f, dt)), color=MARK, lw=1.1, label=text)
    panel.set_yscale("log")
    _mark_plant(panel, plant, measured.frequencies_hz[-1])


def _draw_tracking(panel: Axes, closed: ClosedLoop) -> None:
    measured, tracking = closed.measured, closed.tracking
    f = measured.frequencies_hz
    panel.axhspan(-FLATNESS_DB, FLATNESS_DB, color=SECOND, alpha=0.12, lw=0)
    shown, fitted = 20 * np.log10(np.abs([measured.response, closed.fit.model.response(f)]))
    panel.plot(f, shown, color=SECOND, lw=1.0, label="measured")
    panel.plot(f, fitted, **_LINE, label="low-order fit")
    panel.set_ylim(*_SHOWN_TRACKING_DB)
    if flat := tracking.closed_loop_flat_to_hz:
        _mark(panel, flat, f"±{FLATNESS_DB:g} dB to {flat:.3g} Hz", 0.85)


def _mark_plant(axes: Axes, plant: Plant, highest_hz: float) -> None:
    """Mark the zero of the specimen and the oil column."""
    for root, name in ((plant.antiresonance(), "zero"), (plant.oil_column(), "oil column")):
        if root is not None and root.hz <= highest_hz:
            percent = 100 * (root.damping or 0)
            _mark(axes, root.hz, f"{name}\n{root.hz:.4g} Hz\n$\\zeta$ {percent:.2g} %")


def _mark(axes: Axes, hz: float, text: str, height: float = 0.03) -> None:
    """Draw a line at a frequency and write beside it, on the side where there is room."""
    axes.axvline(hz, **_LINE)
    low, high = axes.get_xlim()
    left = hz**2 > low * high and hz > high / 4
    axes.annotate(
        text, (hz, height), (-4 if left else 4, 0), xycoords=("data", "axes fraction"),
        textcoords="offset points", ha="right" if left else "left", annotation_clip=True, **_NOTE,
    )  # fmt: skip
