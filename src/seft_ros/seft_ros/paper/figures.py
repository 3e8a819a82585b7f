"""The paper's figures: responses of the force loop, and time histories of tests."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from bokeh.models import Range1d
from bokeh.plotting import figure

from seft_ros.design.loop_margins import BAND_HZ
from seft_ros.drawing.style import FIRST, OTHERS, REFERENCE
from seft_ros.page.content import Grid, Plot
from seft_ros.page.plots import band, level, line, mark, plot, time_range
from seft_ros.paper.findings import BEYOND, COMPUTED, Findings
from seft_ros.paper.measures import decibels, growth

Floats = npt.NDArray[np.float64]
Curve = tuple[Floats, dict[str, Floats], str, str]  # time, signals, label, colour
Complexes = npt.NDArray[np.complex128]

_MEASURED, _MODEL = "experiment", "analysis"
_RANGE_HZ = (0.5, 200.0)
_CLOSED_TO_HZ = 60.0
_HEIGHT, _SMALL = 250, 230  # pixels
_UNITS = {"displacement": ("mm", 1e3), "force": ("kN", 1e-3), "acceleration": ("m/s²", 1.0)}
_SIMULATED, _COMPENSATED = OTHERS[2], OTHERS[1]
_STRONG = (0.1, 0.9)  # of the energy: what is shown at first
_MARGIN = 0.3  # s before and after
_FAR = 2.0  # times the largest reference: where a curve that grows is cut


def open_loop_figure(found: Findings) -> Grid:
    """Draw Figure 3: plant, controller and loop; magnitudes above, phases below."""
    measured, model = found.valve.measured, found.valve.loop
    controller = model.controller.sampled_response(
        measured.frequencies_hz, found.experiment.timebase.dt
    )
    f, own, sampled = measured.frequencies_hz, model.frequencies_hz, model.sampled
    zero, pole = found.zero_hz, found.pole_hz
    crossover = model.margins.crossover_hz
    columns = [
        ("(a) valve to force, N/V",
         [(f, measured.response, _MEASURED), (own, sampled.plant, _MODEL)], [zero, pole],
         f"Zero at {zero:.3g} Hz, the specimen's natural frequency; pole at {pole:.3g} Hz, the oil "
         "column."),
        ("(b) controller, V/N", [(own, sampled.controller, "as it runs")], [],
         "Its poles stand on the plant's zero."),
        ("(c) loop",
         [(f, controller * measured.response, _MEASURED), (own, sampled.loop, _MODEL)],
         [] if crossover is None else [crossover],
         "High, then low, without a kink; it crosses 0 dB at the mark."),
    ]  # fmt: skip
    shared = Range1d(*_RANGE_HZ)
    magnitudes, phases = [], []
    for title, curves, marks, caption in columns:
        panels = [
            plot("frequency / Hz", label, x_range=shared, log_x=True, height=_HEIGHT)
            for label in (f"{title}, dB", "phase / degrees")
        ]
        _draw_responses(panels, curves, _RANGE_HZ[1])
        if title.startswith("(c)"):
            level(panels[0], 0.0)
        for hz in marks:
            mark(panels[0], hz)
        magnitudes.append(Plot(panels[0], caption))
        phases.append(Plot(panels[1]))
    return Grid([*magnitudes, *phases])


def closed_loop_figure(found: Findings) -> Grid:
    """Draw Figure 4: reference force to measured force."""
    shared = Range1d(0.0, _CLOSED_TO_HZ, bounds=(0.0, _CLOSED_TO_HZ))
    panels = [
        plot("frequency / Hz", label, x_range=shared)
        for label in ("(a) magnitude, dB", "(b) phase / degrees")
    ]
    measured, model = found.closed.measured, found.valve.loop
    curves = [
        (measured.frequencies_hz, measured.response, _MEASURED),
        (model.frequencies_hz, model.sampled.tracking, _MODEL),
    ]
    _draw_responses(panels, curves, _CLOSED_TO_HZ)
    level(panels[0], 0.0)
    for panel in panels:
        band(panel, 0.0, BAND_HZ, color=FIRST)
    dip_hz = found.closed.tracking.dip_hz
    if dip_hz is not None:
        mark(panels[0], dip_hz)
    captions = (
        f"Flat up to {BAND_HZ:g} Hz (shaded), with a small dip at the mark.",
        f"Nearly a straight line: a delay, here of {1e3 * found.own_delay:.1f} ms.",
    )
    return Grid([Plot(*pair) for pair in zip(panels, captions, strict=True)], columns=2)


def _draw_responses(
    panels: Sequence[figure], curves: Sequence[tuple[Floats, Complexes, str]], to_hz: float
) -> None:
    """Draw magnitude and phase, the experiment below the analysis."""
    for hz, response, label in curves:
        shown = (hz >= _RANGE_HZ[0]) & (hz <= to_hz)
        hz, response = hz[shown], response[shown]
        color, dash = (OTHERS[2], "6 4") if label == _MODEL else (FIRST, "solid")
        phase = np.degrees(np.unwrap(np.angle(response)))
        for panel, values in zip(panels, (decibels(response), phase), strict=True):
            line(panel, hz, values, label, color=color, dash=dash)


def histories_figure(found: Findings) -> Grid:
    """Draw Figure 6: displacement, force and acceleration at three mass ratios."""
    shared = _shared(found)
    plots = []
    letters = iter("abcdefghi")
    for name, (unit, factor) in _UNITS.items():
        for ratio in (0.0, *COMPUTED):
            test = found.tests["rig", ratio]
            curves = [
                (test.time, test.exact, "reference", REFERENCE),
                (test.time, test.measured, "experiment", FIRST),
            ]
            title = f"({next(letters)}) {name}, alpha = {ratio:g}"
            error = test.agreement(name)
            caption = (
                f"Error after the best-fit delay {error.nrmse_aligned:.1%}, largest "
                f"{factor * error.peak:.3g}, reference {factor * error.reference_peak:.3g} {unit}."
            )
            plots.append(_history(name, title, curves, shared, caption))
    return Grid(plots)


def simulations_figure(found: Findings, kind: str, label: str, caption: str) -> Grid:
    """Draw Figure 7 or 8: reference, experiment and a simulation.

    Parameters
    ----------
    found : Findings
        What was calculated.
    kind : str
        Which simulation, as in `Findings.tests`.
    label, caption : str
        Its name in the legend, and what to look for.
    """
    shared = _shared(found)
    color = _SIMULATED if kind == "banded" else _COMPENSATED
    plots = []
    letters = iter("abcd")
    for name in ("displacement", "acceleration"):
        for ratio in COMPUTED:
            rig, test = found.tests["rig", ratio], found.tests[kind, ratio]
            curves = [
                (rig.time, rig.exact, "reference", REFERENCE),
                (rig.time, rig.measured, "experiment", FIRST),
                (test.time, test.measured, label, color),
            ]
            title = f"({next(letters)}) {name}, alpha = {ratio:g}"
            plots.append(_history(name, title, curves, shared, caption))
    return Grid(plots, columns=2)


def pure_delay_figure(found: Findings) -> Plot:
    """Draw what a delay without an end of its bandwidth does at a mass ratio of 1."""
    rig, test = found.tests["rig", 1.0], found.tests["delay", 1.0]
    name = "acceleration"
    most = _FAR * float(np.abs(rig.exact[name]).max())
    beyond = np.flatnonzero(np.abs(test.measured[name]) > most)
    count = int(beyond[0]) if len(beyond) else len(test.time)
    end = min(len(rig.time), max(count + count // 4, 2))
    panel = plot("time / s", f"{name}, alpha = 1 / (m/s²)", x_range=time_range(rig.time[:end]))
    line(panel, rig.time[:end], rig.exact[name][:end], "reference", color=REFERENCE)
    signal = test.measured[name][:count]
    line(panel, test.time[:count], signal, "Eq. 5.4 as it stands", color=_SIMULATED)
    pure = growth(found, "delay", 1.0)
    return Plot(
        panel,
        "Eq. 5.4 with the pure delay {grows} e-fold in {time:.2g} s at {hz:.3g} Hz; ".format(**pure)
        + f"cut where it is {_FAR:g} times the reference's peak.",
        wide=True,
    )


def beyond_figure(found: Findings) -> Grid:
    """Draw displacements with the recommended method on the servo-hydraulic rig."""
    shared = _shared(found)
    plots = []
    for ratio in BEYOND:
        test, plain = found.tests["target", ratio], found.tests["plain", ratio]
        curves = [
            (plain.time, plain.measured, "uncompensated", "#b9c9da"),
            (test.time, test.exact, "reference", REFERENCE),
            (test.time, test.measured, "target_motion", _COMPENSATED),
        ]
        caption = f"Error {test.agreement('displacement').nrmse:.1%} without any shift."
        plots.append(_history("displacement", f"alpha = {ratio:g}", curves, shared, caption))
    return Grid(plots)


def _history(name: str, title: str, curves: Sequence[Curve], shared: Range1d, caption: str) -> Plot:
    unit, factor = _UNITS[name]
    panel = plot("time / s", f"{title} / {unit}", x_range=shared, height=_SMALL)
    for time, signals, label, color in curves:
        dash = "5 3" if color in (_SIMULATED, _COMPENSATED) else "solid"  # what lies below shows
        line(panel, time, factor * signals[name], label, color=color, width=1.1, dash=dash)
    return Plot(panel, caption)


def _shared(found: Findings) -> Range1d:
    """Make a range over the whole test that starts at the motion's strong part."""
    test = found.tests["rig", 0.0]
    shared = time_range(test.time)
    energy = np.cumsum(test.exact["acceleration"] ** 2)
    start, end = np.interp(_STRONG, energy / energy[-1], test.time) if energy[-1] > 0 else (0, 0)
    if end > start:
        shared.start, shared.end = max(0.0, start - _MARGIN), min(shared.end, end + _MARGIN)
    return shared
