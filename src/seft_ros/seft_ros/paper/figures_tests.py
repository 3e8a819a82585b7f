"""Figures 6, 7 and 8: time histories of tests and simulations against the reference."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from bokeh.models import Range1d

from seft_ros.drawing.style import FIRST, OTHERS, REFERENCE
from seft_ros.page.content import Grid, Plot
from seft_ros.page.plots import line, plot, time_range
from seft_ros.paper.findings import BEYOND, COMPUTED, Findings, Key
from seft_ros.paper.outcome import Outcome

Floats = npt.NDArray[np.float64]

_UNITS = {
    "displacement": ("mm", 1e3),
    "force": ("kN", 1e-3),
    "acceleration": ("m/s²", 1.0),
}
_SIMULATED, _COMPENSATED = OTHERS[2], OTHERS[1]
_CALCULATED = (_SIMULATED, _COMPENSATED)
_SMALL = 230  # pixels of height
_STRONG = (0.1, 0.9)  # of the energy: what is shown at first
_MARGIN = 0.3  # s before and after
_FAR = 2.0  # times the largest reference: where a curve that grows is cut


def histories_figure(found: Findings) -> Grid:
    """Draw Figure 6: displacement, force and acceleration at three mass ratios."""
    shared = _shared(found)
    plots = []
    letters = iter("abcdefghi")
    for name, (unit, factor) in _UNITS.items():
        for ratio in (0.0, *COMPUTED):
            test = found.tests["rig", ratio]
            curves = [(test, "exact", "reference", REFERENCE), (test, "", "experiment", FIRST)]
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
            rig = found.tests["rig", ratio]
            curves = [
                (rig, "exact", "reference", REFERENCE),
                (rig, "", "experiment", FIRST),
                (found.tests[kind, ratio], "", label, color),
            ]
            title = f"({next(letters)}) {name}, alpha = {ratio:g}"
            plots.append(_history(name, title, curves, shared, caption))
    return Grid(plots, columns=2)


def pure_delay_figure(found: Findings) -> Plot:
    """Draw what a delay without an end of its bandwidth does at a mass ratio of 1."""
    key: Key = ("delay", 1.0)
    rig, test, growth = found.tests["rig", 1.0], found.tests[key], found.growths[key]
    most = _FAR * float(np.abs(rig.exact["acceleration"]).max())
    beyond = np.flatnonzero(np.abs(test.measured["acceleration"]) > most)
    count = int(beyond[0]) if len(beyond) else len(test.time)
    end = min(len(rig.time), max(count + count // 4, 2))
    panel = plot("time / s", "acceleration, alpha = 1 / (m/s²)", x_range=time_range(rig.time[:end]))
    line(panel, rig.time[:end], rig.exact["acceleration"][:end], "reference", color=REFERENCE)
    line(
        panel,
        test.time[:count],
        test.measured["acceleration"][:count],
        "Eq. 5.4 as it stands",
        color=_SIMULATED,
    )
    ends = "grows" if growth.rate > 0 else "decays"
    return Plot(
        panel,
        f"Eq. 5.4 with the pure delay {ends} e-fold in {1 / abs(growth.rate):.2g} s at "
        f"{growth.hz:.3g} Hz; cut where it is {_FAR:g} times the reference's peak.",
        wide=True,
    )


def beyond_figure(found: Findings) -> Grid:
    """Draw displacements with the recommended method on the servo-hydraulic rig."""
    shared = _shared(found)
    plots = []
    for ratio in BEYOND:
        test, plain = found.tests["target", ratio], found.tests["plain", ratio]
        curves = [
            (plain, "", "uncompensated", "#b9c9da"),
            (test, "exact", "reference", REFERENCE),
            (test, "", "target_motion", _COMPENSATED),
        ]
        error = test.agreement("displacement").nrmse
        caption = f"Error {error:.1%} without any shift."
        plots.append(_history("displacement", f"alpha = {ratio:g}", curves, shared, caption))
    return Grid(plots)


def _history(
    name: str,
    title: str,
    curves: Sequence[tuple[Outcome, str, str, str]],
    shared: Range1d,
    caption: str,
) -> Plot:
    unit, factor = _UNITS[name]
    panel = plot("time / s", f"{title} / {unit}", x_range=shared, height=_SMALL)
    for test, which, label, color in curves:
        dash = "5 3" if color in _CALCULATED else "solid"  # what lies below must show
        signal = (test.exact if which else test.measured)[name]
        line(panel, test.time, factor * signal, label, color=color, width=1.1, dash=dash)
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
