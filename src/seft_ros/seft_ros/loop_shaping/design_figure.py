"""A figure of a shaped force loop: plant, controller, loop and closed loop (paper Figs. 3, 4)."""

from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from seft_ros.drawing.style import FIRST, MARK, REFERENCE, TEXT, legend_below, tidy
from seft_ros.loop_shaping.design import LoopDesign
from seft_ros.loop_shaping.margins import BAND_HZ, FLATNESS_DB

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

_SHOWN_DEG = 720.0
_SHOWN_DB = 80.0  # below a response's largest magnitude nothing of interest lies
_NOTE: dict[str, Any] = {"fontsize": 8, "color": MARK, "ha": "left", "va": "bottom"}

_Panel = tuple[Axes, Axes]  # magnitude above phase


def design_figure(design: LoopDesign, title: str) -> Figure:
    """Draw magnitude and phase of plant, controller, loop and closed loop over frequency."""
    figure = Figure(figsize=(11.5, 9.5), layout="constrained")
    FigureCanvasAgg(figure)
    rows = figure.subplots(4, 2, sharex=True, height_ratios=[1.4, 1.0, 1.4, 1.0])
    panels = [(rows[row, column], rows[row + 1, column]) for row in (0, 2) for column in (0, 1)]
    plant, controller, loop, closed = panels
    before, after = design.continuous, design.sampled
    f = design.frequencies_hz
    _draw(plant, f, before.plant, after.plant, "plant $H_{fu}$, valve to force", "N/V")
    _draw(controller, f, before.controller, after.controller, "controller $C_f$", "V/N")
    _draw(loop, f, before.loop, after.loop, "loop $L = C_f H_{fu}$", "")
    _draw(closed, f, before.tracking, after.tracking, "closed loop $T = L / (1 + L)$", "")
    _mark_plant(plant, design)
    _mark_loop(loop, design)
    _mark_closed_loop(closed, design)
    for panel in rows[-1]:
        panel.set_xlabel("frequency / Hz", color=TEXT)
        panel.set_xlim(_lowest_hz(design), f[-1])
        panel.xaxis.set_major_formatter("{x:g}")
    figure.align_ylabels()
    handles, labels = plant[0].get_legend_handles_labels()
    legend_below(figure, dict(zip(labels, handles, strict=True)), 2)
    figure.suptitle(title, fontsize=11, color=TEXT, parse_math=False)
    return figure


def _draw(
    panel: _Panel, f: Floats, continuous: Complexes, sampled: Complexes, title: str, unit: str
) -> None:
    magnitude, phase = panel
    highest, lowest = -np.inf, np.inf
    for response, colour, width, label in (
        (continuous, REFERENCE, 2.2, "continuous, without dead time"),
        (sampled, FIRST, 1.1, "as it runs: sampled, held, a step late"),
    ):
        finite = np.isfinite(response) & (response != 0)
        decibels = 20 * np.log10(np.abs(response[finite]))
        for axes, values in ((magnitude, decibels), (phase, _phase(response[finite]))):
            axes.semilogx(f[finite], values, color=colour, lw=width, label=label)
        highest, lowest = max(highest, decibels.max()), min(lowest, decibels.min())
    room = 0.05 * min(highest - lowest, _SHOWN_DB) + 1.0
    magnitude.set_ylim(max(lowest, highest - _SHOWN_DB) - room, highest + room)
    magnitude.set_title(title, loc="left", fontsize=11, color=TEXT)
    magnitude.set_ylabel(f"magnitude / dB ({unit})" if unit else "magnitude / dB", color=TEXT)
    phase.set_ylabel("phase / deg", color=TEXT)
    low, high = phase.get_ylim()
    low = max(low, -_SHOWN_DEG)
    phase.set_ylim(low, high)
    phase.yaxis.set_major_locator(MultipleLocator(90.0 if high - low < 400 else 180.0))
    for axes in panel:
        tidy(axes)


def _mark_plant(panel: _Panel, design: LoopDesign) -> None:
    plant = design.plant
    for root, name in ((plant.antiresonance(), "zero"), (plant.oil_column(), "oil column")):
        if root is not None:
            _line(panel, root.hz)
            _note(panel[0], root.hz, f"{name}\n{root.hz:.3g} Hz", before=name != "zero")


def _mark_loop(panel: _Panel, design: LoopDesign) -> None:
    magnitude, phase = panel
    margins = design.margins
    magnitude.axhline(0.0, color=MARK, lw=0.8, ls=":")
    phase.axhline(-180.0, color=MARK, lw=0.8, ls=":")
    if margins.crossover_hz is not None:
        _line(panel, margins.crossover_hz)
        _note(magnitude, margins.crossover_hz, f"crossover\n{margins.crossover_hz:.3g} Hz")
        _note(phase, margins.crossover_hz, f"{margins.phase_margin_deg:.3g}° phase margin")
    if margins.phase_crossover_hz is not None and margins.gain_margin_db is not None:
        at, depth = margins.phase_crossover_hz, -margins.gain_margin_db
        magnitude.plot([at, at], [depth, 0.0], color=MARK, lw=1.6)
        text = f"{margins.gain_margin_db:.3g} dB gain margin"
        magnitude.annotate(text, (at, 0.0), (2, 3), textcoords="offset points", **_NOTE)


def _mark_closed_loop(panel: _Panel, design: LoopDesign) -> None:
    magnitude, phase = panel
    tracking = design.tracking
    magnitude.axhspan(-FLATNESS_DB, FLATNESS_DB, color=FIRST, alpha=0.12, lw=0)
    magnitude.set_ylim(-20.0, max(6.0, magnitude.get_ylim()[1]))
    _line(panel, BAND_HZ)
    flat = tracking.flat_to_hz
    text = "flat throughout" if flat is None else f"±{FLATNESS_DB:g} dB to {flat:.3g} Hz"
    if tracking.dip_db is not None:
        text += f"\ndip {tracking.dip_db:.2g} dB at {tracking.dip_hz:.3g} Hz"
    magnitude.text(0.02, 0.06, text, transform=magnitude.transAxes, **_NOTE)
    _note(magnitude, BAND_HZ, f"{BAND_HZ:g} Hz")
    if tracking.delay_s is not None:
        f = design.frequencies_hz[design.frequencies_hz <= BAND_HZ]
        phase.semilogx(f, -360.0 * f * tracking.delay_s, color=MARK, lw=1.0, ls="--")
        text = f"best-fit delay {1e3 * tracking.delay_s:.3g} ms"
        phase.text(0.02, 0.08, text, transform=phase.transAxes, **_NOTE)


def _lowest_hz(design: LoopDesign) -> float:
    """Where to begin: an integrator goes on like this below."""
    places = [design.margins.crossover_hz, *(root.hz for root in design.plant.zeros()[:1])]
    shown = [hz for hz in places if hz]
    return max(design.frequencies_hz[0], min(shown) / 30 if shown else 0.0)


def _line(panel: _Panel, hz: float) -> None:
    for axes in panel:
        axes.axvline(hz, color=MARK, lw=0.8, ls="--")


def _note(axes: Axes, hz: float, text: str, before: bool = False) -> None:
    """Write beside a frequency, at the lower edge."""
    style = {**_NOTE, "ha": "right"} if before else _NOTE
    axes.annotate(
        text, (hz, 0.03), (-4 if before else 4, 0), xycoords=("data", "axes fraction"),
        textcoords="offset points", annotation_clip=True, **style,
    )  # fmt: skip


def _phase(response: Complexes) -> Floats:
    """Unwrapped phase in degrees, starting between -270 and 90: a loop's lags, it does not lead."""
    degrees = np.degrees(np.unwrap(np.angle(response)))
    turns = np.ceil((degrees[0] - 90.0) / 360.0)
    return degrees - 360.0 * turns
